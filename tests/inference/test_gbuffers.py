"""Which rays are cast anew when a scene or a camera changes; what comes out is what a new source would give."""

import numpy as np
import pytest
from edited_scenes import changed, dimmed, lamp, moved, recoloured, scene

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
    """What was cast or built, as it happens."""
    log: list[str] = []
    for name in ("first_hit", "camera_caster", "LightSampler", "RayCaster"):
        real = getattr(rfpp.inference.gbuffers, name)
        monkeypatch.setattr(
            rfpp.inference.gbuffers, name, lambda *args, name=name, real=real: log.append(name) or real(*args)
        )
    return log


@pytest.mark.parametrize("channels", [PAPER, LIT])
@pytest.mark.parametrize("edit", [recoloured, dimmed])
def test_other_colors_and_powers_leave_first_hits_as_they_are(channels, edit, cast):
    source = GBufferSource(channels)
    before = stacked(source, scene())
    assert cast.count("first_hit") == 3
    cast.clear()
    after = stacked(source, edit(scene()))
    assert not {"first_hit", "camera_caster", "RayCaster"} & set(cast)
    np.testing.assert_array_equal(after, stacked(GBufferSource(channels), edit(scene())))
    assert np.array_equal(before, after) == (channels == PAPER and edit is dimmed)


@pytest.mark.parametrize("channels", [PAPER, LIT])
def test_a_moved_object_is_seen_where_it_is(channels, cast):
    source = GBufferSource(channels)
    before = stacked(source, scene())
    after = stacked(source, moved(scene()))
    assert cast.count("first_hit") == 6
    np.testing.assert_array_equal(after, stacked(GBufferSource(channels), moved(scene())))
    assert not np.array_equal(before, after)


def test_what_begins_to_emit_is_no_longer_seen():
    source = GBufferSource(PAPER)
    glowing = changed(scene(), "floor", material=lamp(5))
    before, after = stacked(source, scene()), stacked(source, glowing)
    assert (after[:, :3].sum(1) > 0).sum() < (before[:, :3].sum(1) > 0).sum()
    np.testing.assert_array_equal(after, stacked(GBufferSource(PAPER), glowing))


def test_another_camera_casts_its_own_rays_into_the_same_structures(cast):
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
