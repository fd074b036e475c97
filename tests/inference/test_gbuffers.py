"""Caching of G-buffers: an edit casts the necessary rays only, and equals a new source."""

import numpy as np
import pytest
from edited_scenes import changed, dimmed, lamp, moved, recolored, scene

import rfpp.inference.gbuffers
from rfpp.inference.gbuffers import GBufferSource
from rfpp.scene.packed import pack

PAPER = ("albedo", "normal", "roughness")
LIT = (*PAPER, "specular", "direct_diffuse", "direct_glossy")


def stacked(source: GBufferSource, of, resolution: int = 16) -> np.ndarray:
    packed = pack(of)
    view = source.of(packed, resolution, resolution, light_samples=4)
    return np.stack([view(number) for number in range(len(packed.fov))])


@pytest.fixture
def cast(monkeypatch) -> list[str]:
    """Log of cast rays and built structures."""
    log: list[str] = []
    for name in ("first_hit", "camera_caster", "LightSampler", "RayCaster"):
        real = getattr(rfpp.inference.gbuffers, name)
        monkeypatch.setattr(
            rfpp.inference.gbuffers, name, lambda *args, name=name, real=real: log.append(name) or real(*args)
        )
    return log


@pytest.mark.parametrize("channels", [PAPER, LIT])
@pytest.mark.parametrize("edit", [recolored, dimmed])
def test_colors_and_powers_do_not_change_first_hits(channels, edit, cast):
    source = GBufferSource(channels)
    before = stacked(source, scene())
    assert cast.count("first_hit") == 3
    cast.clear()
    after = stacked(source, edit(scene()))
    assert not {"first_hit", "camera_caster", "RayCaster"} & set(cast)
    np.testing.assert_array_equal(after, stacked(GBufferSource(channels), edit(scene())))
    assert np.array_equal(before, after) == (channels == PAPER and edit is dimmed)


@pytest.mark.parametrize("channels", [PAPER, LIT])
def test_a_moved_object_casts_new_rays(channels, cast):
    source = GBufferSource(channels)
    before = stacked(source, scene())
    after = stacked(source, moved(scene()))
    assert cast.count("first_hit") == 6
    np.testing.assert_array_equal(after, stacked(GBufferSource(channels), moved(scene())))
    assert not np.array_equal(before, after)


def test_an_object_that_starts_to_emit_becomes_invisible():
    source = GBufferSource(PAPER)
    glowing = changed(scene(), "floor", material=lamp(5))
    before, after = stacked(source, scene()), stacked(source, glowing)
    assert (after[:, :3].sum(1) > 0).sum() < (before[:, :3].sum(1) > 0).sum()
    np.testing.assert_array_equal(after, stacked(GBufferSource(PAPER), glowing))


def test_another_camera_reuses_acceleration_structures(cast):
    source = GBufferSource(LIT)
    stacked(source, scene())
    cast.clear()
    turned = scene().model_copy(update={"cameras": scene().cameras[:1] + scene().cameras[:0:-1]})
    stacked(source, turned)
    assert cast == []
    zoomed = scene().model_copy(update={"cameras": [scene().cameras[0].model_copy(update={"fov": 30.0})]})
    np.testing.assert_array_equal(stacked(source, zoomed), stacked(GBufferSource(LIT), zoomed))
    assert cast[0] == "first_hit"
    assert cast.count("camera_caster") == 1  # of the new source
    assert stacked(source, scene(), 8).shape == (3, 16, 8, 8)
