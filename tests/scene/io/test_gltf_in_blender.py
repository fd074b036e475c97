"""Pictures of glTF files are those of Blender, which reads them with its own importer and traces paths."""

import tempfile
import warnings
from pathlib import Path

import numpy as np
import pytest
from gltf_rooms import ROOMS, blender_picture
from marks import requires_blender

from rfpp import Renderer
from rfpp.imaging.exr import read_exr
from rfpp.metrics.flip import flip

pytestmark = requires_blender

SIZE, SAMPLES = 64, 64
#: ꟻLIP is below 0.1 (0.25 if bricks or leaves were averaged), and the mean color within 4%. A spot's edge is softer
#: here, and its dark surroundings are noisy.
SPOT = {"spot": (0.4, 0.2)}


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer.load("radiosity")


@pytest.mark.parametrize("kind", ROOMS)
def test_a_picture_is_blenders(kind: str, renderer: Renderer, in_process) -> None:
    largest_flip, tolerance = SPOT.get(kind, (0.1, 0.04))
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = ROOMS[kind]().write(Path(folder))
        in_process(blender_picture, path, Path(folder) / "truth.exr", SIZE, SAMPLES)
        truth = next(layer for layer in read_exr(Path(folder) / "truth.exr").values() if layer.ndim == 3)[..., :3]
        image = renderer.render(path, resolution=SIZE)[0]
    assert flip(image, truth.astype(np.float32)).mean() < largest_flip
    np.testing.assert_allclose(image.mean(axis=(0, 1)), truth.mean(axis=(0, 1)), rtol=tolerance)
