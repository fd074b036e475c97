"""Which rays are cast anew when a scene or a camera changes; what comes out is what a new source would give."""

from dataclasses import replace

import numpy as np
import pytest
from edited_scenes import changed, dimmed, lamp, moved, recoloured, scene

import rfpp.inference.gbuffers
from rfpp.raycast.first_hit import BOUNCED_LIGHT, CELL_CHANNELS
from rfpp.inference.gbuffers import GBufferSource
from rfpp.scene.packed import pack

PAPER = ("albedo", "normal", "roughness")
LIT = (*PAPER, "specular", "direct_diffuse", "direct_glossy")
GATHERED = (*LIT, *CELL_CHANNELS, BOUNCED_LIGHT)


def stacked(source: GBufferSource, of, resolution: int = 16) -> np.ndarray:
    packed = pack(of)
    view = source.of(packed, resolution, resolution, light_samples=4)
    return np.stack([view(number) for number in range(len(packed.fov))])


@pytest.fixture
def cast(monkeypatch) -> list[str]:
    """What was cast or built, as it happens."""
    log: list[str] = []
    for name in ("first_hit", "camera_caster", "LightSampler", "RayCaster", "find_places"):
        real = getattr(rfpp.inference.gbuffers, name)
        monkeypatch.setattr(
            rfpp.inference.gbuffers, name, lambda *args, name=name, real=real: log.append(name) or real(*args)
        )
    return log


@pytest.mark.parametrize("channels", [PAPER, LIT, GATHERED])
@pytest.mark.parametrize("edit", [recoloured, dimmed])
def test_other_colours_and_powers_leave_first_hits_and_places_of_cells_as_they_are(channels, edit, cast):
    source = GBufferSource(channels)
    before = stacked(source, scene())
    assert cast.count("first_hit") == 3 and cast.count("find_places") == (channels == GATHERED)
    cast.clear()
    after = stacked(source, edit(scene()))
    assert not {"first_hit", "camera_caster", "RayCaster", "find_places"} & set(cast)
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


@pytest.mark.parametrize("edit", [recoloured, dimmed, moved])
def test_light_of_objects_follows_every_edit_and_is_gathered_once(edit, cast):
    source = GBufferSource(LIT)
    before, again = (source.object_light(pack(scene()).triangles) for _ in range(2))
    assert before is again and cast.count("LightSampler") == 1
    after = source.object_light(pack(edit(scene())).triangles)
    assert not np.array_equal(before, after)
    np.testing.assert_array_equal(after, GBufferSource(LIT).object_light(pack(edit(scene())).triangles))


def test_objects_that_were_joined_have_one_light():
    source, triangles = GBufferSource(LIT), pack(scene()).triangles
    offsets = np.delete(triangles.object_offsets, 1)
    joined = replace(triangles, object_offsets=offsets, object_names=triangles.object_names[1:])
    assert len(source.object_light(joined)) == len(source.object_light(triangles)) - 1


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


def test_no_channels_no_rays(cast):
    assert stacked(GBufferSource(()), scene()).shape == (3, 0, 16, 16)
    assert cast == []


@pytest.mark.parametrize(("samples", "of_point", "rays"), [(1, 1, 1), (2, 1, 2), (4, 1, 4), (8, 2, 4), (64, 16, 4)])
def test_samples_of_a_pixel_are_divided_among_its_points(samples, of_point, rays, monkeypatch):
    asked, real = [], rfpp.inference.gbuffers.with_known_light
    monkeypatch.setattr(
        rfpp.inference.gbuffers, "with_known_light", lambda *args, **how: asked.append(args[4]) or real(*args, **how)
    )
    seen = GBufferSource(GATHERED).seen(pack(scene()), 16, 16, samples, points=2)(0)
    assert asked == [of_point]
    assert all(of_ray.shape == (16, 16, rays) for of_ray in seen.cells.rays.values())
