"""The network that comes with the project: its pictures stay what they were, and it has learned light.

Pictures and references in `rfpp_tiny/` are EXR files made by

    python launch/render.py 'scene=[data/scenes/cornell_box.json,data/scenes/roughness_spheres.json]' cameras=0 \
        resolution=64 device=cpu precision=fp32 reference=true reference_settings=paper output=tests/inference/rfpp_tiny
"""

from pathlib import Path

import numpy as np
import pytest
import torch

from rfpp.checkpoint.shipped import shipped
from rfpp.raycast.first_hit import CHANNELS
from rfpp.imaging.exr import read_exr
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.renderer import Renderer
from rfpp.metrics.image import log_l1
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene, pack

PICTURES = Path(__file__).parent / "rfpp_tiny"
SCENES = Path(__file__).parents[2] / "data" / "scenes"
NAMES = ["cornell_box", "roughness_spheres"]


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer.load("rfpp-tiny", "cpu", "fp32")


def view_of(name: str) -> PackedScene:
    return pack(load_scene(SCENES / f"{name}.json")).views([0])


def reference_image(name: str) -> np.ndarray:
    return read_exr(PICTURES / f"{name}.exr")["RGB"].astype(np.float32)


def difference(image: np.ndarray, other: np.ndarray) -> float:
    return float(log_l1(*(torch.from_numpy(np.ascontiguousarray(a)).permute(2, 0, 1)[None] for a in (image, other))))


def known(name: str) -> dict[str, np.ndarray]:
    """[64, 64, C] channels that the network is given."""
    names = ("albedo", "specular", "direct_diffuse", "direct_glossy", "reflected_light")
    stacked = GBufferSource(names).of(view_of(name), 64, 64, 16)(0)
    parts = np.split(stacked.transpose(1, 2, 0), np.cumsum([CHANNELS[n] for n in names])[:-1], axis=-1)
    return dict(zip(names, parts, strict=True))


@pytest.mark.parametrize("name", NAMES)
def test_its_pictures_are_the_committed_ones(renderer, name):
    [image] = renderer.render(view_of(name), 64)
    expected = reference_image(f"{name}_0")
    assert difference(image, expected) < 2e-4
    assert np.quantile(np.abs(image - expected), 0.99) < 0.02


@pytest.mark.parametrize("name", NAMES)
def test_bfloat16_gives_the_same_pictures_to_the_eye(name):
    [image] = Renderer.load("rfpp-tiny", "cpu", "bf16").render(view_of(name), 64)
    assert difference(image, reference_image(f"{name}_0")) < 2e-3


def test_a_red_wall_reddens_what_is_near_it(renderer):
    given = known("cornell_box")
    grey = (np.ptp(given["albedo"], axis=-1) < 0.02) & (given["albedo"].min(-1) > 0.1)
    left = np.arange(64) < 32
    further = renderer.render(view_of("cornell_box"), 64)[0] - given["albedo"] * given["direct_diffuse"]
    near, far = (further[grey & side].mean(0) for side in (left, ~left))
    assert 2.9 > near[0] / near[1] > 1.9 and 1.15 > far[0] / far[1] > 0.9  # red / green; Cycles has 2.3 and 1.0


@pytest.mark.parametrize("name", NAMES)
def test_it_adds_to_the_light_that_it_is_given(renderer, name):
    given, reference = known(name), reference_image(f"{name}_0_reference")
    glossy = given["direct_glossy"] + given["reflected_light"]
    alone = given["albedo"] * given["direct_diffuse"] + given["specular"] * glossy
    [image] = renderer.render(view_of(name), 64)
    assert difference(image, reference) < 0.3 * difference(alone, reference)


@pytest.mark.parametrize("name", NAMES)
def test_outlines_are_closer_to_the_reference_where_pixels_have_more_points(renderer, name):
    reference = reference_image(f"{name}_0_reference")

    def errors(refined: bool) -> list[float]:
        images = (renderer.views(view_of(name), 64, supersampling=n, refined=refined) for n in (1, 2, 3))
        return [difference(next(image), reference) for image in images]

    one, two, three = errors(refined=False)
    assert three < two < 0.85 * one
    one, two, three = errors(refined=True)  # which has not learned from nine points
    assert max(two, three) < 0.85 * one


def test_what_is_installed_holds_no_code():
    folder = shipped("rfpp-tiny")
    assert {path.name for path in folder.iterdir()} == {"README.md", "config.json", "model.safetensors"}
    assert sum(path.stat().st_size for path in folder.iterdir()) < 20e6
