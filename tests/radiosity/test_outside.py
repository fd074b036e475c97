"""Light where it is hard: near a ceiling, in a Cornell box, through a window, in furnaces, behind a wall.

`mitsuba_light_below_ceiling.npz` holds images of 32² pixels of four scenes of `benchmark=outside`, rendered by Mitsuba
3.9.1 (`path`, 128², 128 samples, averaged over 4 × 4 pixels).
"""

from pathlib import Path

import numpy as np
import pytest
import torch

from rfpp.benchmark.mitsuba_reference import sees_emitters
from rfpp.benchmark.outside import _agreement
from rfpp.commands import CONFIG_DIR
from rfpp.imaging.exr import read_exr
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.plan import Plan
from rfpp.inference.radiosity_engine import RadiosityEngine
from rfpp.inference.renderer import Renderer
from rfpp.radiosity.radiosity import Radiosity
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene, pack

REFERENCES = Path(__file__).with_name("mitsuba_light_below_ceiling.npz")
SCENES = CONFIG_DIR.parent / "data" / "scenes" / "outside"


def load(name: str) -> PackedScene:
    return pack(load_scene(SCENES / f"{name}.json"))


def render(scene: PackedScene, resolution: int = 64) -> np.ndarray:
    engine = RadiosityEngine(Radiosity(), torch.device("cpu"), torch.float32)
    return np.stack(list(engine.views(Plan(scene, (resolution, resolution)))))


@pytest.mark.parametrize("gap", [0.005, 0.02, 0.1, 0.3])
def test_a_light_below_a_ceiling(gap):
    scene = load(f"light_{gap:g}_below_ceiling")
    expected = np.load(REFERENCES)[f"gap_{gap:g}"].astype(np.float64)
    image = render(scene)[0].reshape(32, 2, 32, 2, 3).mean((1, 3))
    unmasked = ~sees_emitters(scene, 0, 32)
    assert image[unmasked].sum() == pytest.approx(expected[unmasked].sum(), rel=0.05)


@pytest.mark.parametrize("sides", ["one", "two"])
def test_bitterlis_cornell_box(sides):
    scene, expected = load(f"cornell_box_{sides}_sided"), read_exr(SCENES / f"cornell_box_{sides}_sided.exr")["RGB"]
    renderer = Renderer.load("radiosity")
    unrefined = np.stack(list(renderer.views(scene, 128, is_refined=False)))
    for image in (unrefined[0], renderer.refined(unrefined, scene)[0]):
        agreement = _agreement(image, expected, sees_emitters(scene, 0, 128), expected)
        assert agreement["energy"] == pytest.approx(1, abs=0.02)
        assert agreement["relative_l1"] < 0.05


@pytest.mark.parametrize("albedo", [0.5, 0.8])
def test_a_furnace_matches_its_closed_form(albedo):
    assert render(load(f"furnace_{albedo:g}"), 16).mean() == pytest.approx(albedo / (1 - albedo), rel=0.02)


def test_no_light_passes_through_a_wall():
    lit, dark = render(load("two_rooms"))
    assert dark.mean() < 0.005 * lit.mean()


def test_light_through_an_opening_is_unbiased_at_few_samples():
    source = GBufferSource(["direct_diffuse"])
    images = (source.of(load("window"), side, side, samples)(0) for side, samples in ((256, 4), (128, 256)))
    few, many = (image.mean(dtype=np.float64) for image in images)
    assert many > 0
    assert few == pytest.approx(many, rel=0.02)
