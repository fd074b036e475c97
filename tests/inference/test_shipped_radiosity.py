"""The included radiosity model: its pictures stay what they were, and the refinement has learned.

Pictures and references in `radiosity/` are EXR files made by

    python launch/render.py 'scene=[data/scenes/cornell_box.json,data/scenes/roughness_spheres.json]' cameras=0 \
        resolution=128 device=cpu precision=fp32 reference=true reference_settings=paper \
        output=tests/inference/radiosity
"""

from pathlib import Path

import numpy as np
import pytest
import torch

from rfpp.checkpoint.shipped import shipped
from rfpp.imaging.exr import read_exr
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.renderer import Renderer
from rfpp.metrics.image import log_l1
from rfpp.raycast.first_hit import CHANNELS
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene, pack

PICTURES = Path(__file__).parent / "radiosity"
SCENES = Path(__file__).parents[2] / "data" / "scenes"
NAMES = ["cornell_box", "roughness_spheres"]


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer.load("radiosity", "cpu", "fp32")


def view_of(name: str) -> PackedScene:
    return pack(load_scene(SCENES / f"{name}.json")).views([0])


def picture(name: str) -> np.ndarray:
    return read_exr(PICTURES / f"{name}.exr")["RGB"].astype(np.float32)


def difference(image: np.ndarray, other: np.ndarray) -> float:
    return float(log_l1(*(torch.from_numpy(np.ascontiguousarray(a)).permute(2, 0, 1)[None] for a in (image, other))))


def known(name: str) -> dict[str, np.ndarray]:
    """[128, 128, C] G-buffer channels with direct light and reflections."""
    names = ("albedo", "specular", "direct_diffuse", "direct_glossy", "reflected_light")
    stacked = GBufferSource(names).of(view_of(name), 128, 128, 16)(0)
    parts = np.split(stacked.transpose(1, 2, 0), np.cumsum([CHANNELS[n] for n in names])[:-1], axis=-1)
    return dict(zip(names, parts, strict=True))


@pytest.mark.parametrize("name", NAMES)
def test_pictures_equal_the_committed_ones(renderer, name):
    [image] = renderer.render(view_of(name), 128)
    expected = picture(f"{name}_0")
    assert difference(image, expected) < 2e-4
    assert np.quantile(np.abs(image - expected), 0.99) < 0.02


@pytest.mark.parametrize("name", NAMES)
def test_bfloat16_gives_nearly_the_same_pictures(name):
    [image] = Renderer.load("radiosity", "cpu", "bf16").render(view_of(name), 128)
    assert difference(image, picture(f"{name}_0")) < 2e-3


def test_a_red_wall_colors_the_gray_surfaces_near_it(renderer):
    channels = known("cornell_box")
    gray = (np.ptp(channels["albedo"], axis=-1) < 0.02) & (channels["albedo"].min(-1) > 0.1)
    left = np.arange(128) < 64
    bounced = renderer.render(view_of("cornell_box"), 128)[0] - channels["albedo"] * channels["direct_diffuse"]
    near, far = (bounced[gray & side].mean(0) for side in (left, ~left))
    assert 2.9 > near[0] / near[1] > 1.9 and 1.15 > far[0] / far[1] > 0.9  # red / green; Cycles has 2.3 and 1.0


@pytest.mark.parametrize("name", NAMES)
def test_it_is_closer_to_the_reference_than_direct_light_and_reflections(renderer, name):
    channels, reference = known(name), picture(f"{name}_0_reference")
    glossy = channels["direct_glossy"] + channels["reflected_light"]
    baseline = channels["albedo"] * channels["direct_diffuse"] + channels["specular"] * glossy
    [image] = renderer.render(view_of(name), 128)
    assert difference(image, reference) < 0.3 * difference(baseline, reference)


def test_the_refinement_reduces_the_error(renderer):
    def error(name: str, is_refined: bool) -> float:
        image = next(renderer.views(view_of(name), 128, is_refined=is_refined))
        return difference(image, picture(f"{name}_0_reference"))

    refined, unrefined = (np.mean([error(name, is_refined) for name in NAMES]) for is_refined in (True, False))
    assert refined < 0.95 * unrefined


def test_the_installed_folder_is_small_and_holds_no_code():
    folder = shipped("radiosity")
    assert {path.name for path in folder.iterdir()} == {"README.md", "config.json", "model.safetensors"}
    assert sum(path.stat().st_size for path in folder.iterdir()) < 1e6
