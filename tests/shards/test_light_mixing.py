"""Scenes stored light by light: sums are the scene, and mixtures the scene under other lights."""

from dataclasses import replace

import numpy as np
import pytest
from small_data import REFERENCE, SETTINGS, invented, make
from two_lights import POWERS, TwoLights, invented_lights

from rfpp.errors import ShardError, UserError
from rfpp.radiosity.cells import parts
from rfpp.raycast.first_hit import CHANNELS, LIGHT_CHANNELS, stack_channels
from rfpp.reference.cycles import render_lights
from rfpp.scene.triangles import EMISSION
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.job import SceneJob, SceneTask
from rfpp.shards.mixing import mixed
from rfpp.shards.sample import SceneSample, decode, encode
from rfpp.shards.tar import unpack

ORIGINAL = np.ones((2, 3))
OTHER = np.array([[0.3, 0.5, 2.0], [4.0, 1.0, 0.25]])
DATA = replace(SETTINGS, resolution=12, light_samples=4, by_light=True)


def members(factors=ORIGINAL, **data) -> dict[str, bytes]:
    family = TwoLights(factors=tuple(map(tuple, factors.tolist())))
    job = SceneJob(family, REFERENCE, replace(DATA, **data), "fingerprint", invented, invented_lights)
    return unpack(job(SceneTask("train", 1)).blocks)[1]


@pytest.fixture(scope="module")
def members_of_sample() -> dict[str, bytes]:
    return members()


@pytest.fixture
def sample(members_of_sample) -> SceneSample:
    return decode("train-000001", members_of_sample)


def require_same(found: SceneSample, expected: SceneSample) -> None:
    """All that is known of light, to half precision of what is summed."""

    def close(ours: np.ndarray, theirs: np.ndarray) -> None:
        np.testing.assert_allclose(ours, theirs, rtol=2**-10, atol=1e-6 + 2**-11 * float(np.abs(theirs).mean()))

    close(found.triangles.material, expected.triangles.material)
    close(found.images, expected.images)
    close(found.object_light, expected.object_light)
    for name, array in parts(expected.cells).items():
        close(getattr(found.cells, name), array)
    for ours, theirs, fov in zip(found.gbuffers, expected.gbuffers, expected.fov, strict=True):
        for name in CHANNELS:
            both = (ours, found.triangles), (theirs, expected.triangles)
            close(*(stack_channels(gbuffer, triangles.material, fov, [name]) for gbuffer, triangles in both))


def test_mixed_as_they_were_lights_give_the_stored_scene(sample):
    assert sample.images.mean() > 0.1
    assert all(sample.lights.known[name].reshape(2, -1).any(1).all() for name in LIGHT_CHANNELS)
    require_same(mixed(sample, ORIGINAL), sample)


def test_a_mixture_is_the_scene_with_such_lights(sample):
    fresh = decode("train-000001", members(OTHER))
    np.testing.assert_allclose(fresh.triangles.material[-2:, EMISSION], POWERS * OTHER)
    assert not np.allclose(fresh.images, sample.images, rtol=0.2)
    require_same(mixed(sample, OTHER), fresh)


def test_what_is_not_light_stays(sample):
    other = mixed(sample, OTHER)
    np.testing.assert_array_equal(other.triangles.material[:, :7], sample.triangles.material[:, :7])
    np.testing.assert_array_equal(other.gbuffers[0].normal, sample.gbuffers[0].normal)
    np.testing.assert_array_equal(other.gbuffers[0].reflection.albedo, sample.gbuffers[0].reflection.albedo)
    np.testing.assert_array_equal(other.cells.hits, sample.cells.hits)


def test_known_light_is_that_of_a_data_set_without(members_of_sample):
    plain = members(by_light=False)
    assert plain.keys() < members_of_sample.keys()
    same = [name for name in plain if "view" not in name or name.count(".") == 2]
    assert {"view0.light.exr", "view0.cells.exr", "cells.safetensors"} <= {*same}
    assert all(plain[name] == members_of_sample[name] for name in same)


def test_samples_are_a_fixed_point_and_bytes_are_reproducible(members_of_sample, sample):
    assert encode(sample) == members_of_sample == members()


def test_layers_are_read_only_where_they_are_asked_for(members_of_sample):
    without = {name: data for name, data in members_of_sample.items() if "of_light" not in name}
    assert decode("train-000001", without, by_light=False).lights is None
    one = decode("train-000001", members_of_sample, choose=lambda views: [1], channels=("albedo",))
    assert one.lights.images.shape == (2, 1, 12, 12, 3)
    assert one.gbuffers[0].light is None
    np.testing.assert_allclose(mixed(one, ORIGINAL).images, one.images, rtol=2**-10, atol=1e-6)


@pytest.mark.parametrize("damage", ["missing", "of another size"])
def test_damaged_layers_are_named(members_of_sample, damage):
    other = members(resolution=8)
    broken = dict(members_of_sample)
    if damage == "missing":
        del broken["view1.of_light0.exr"]
    else:
        broken |= {name: data for name, data in other.items() if "of_light" in name}
    with pytest.raises(ShardError, match="train-000001"):
        decode("train-000001", broken)


def test_a_scene_stored_without_says_how_to_store_it_with():
    sample = decode("train-000001", members(by_light=False))
    with pytest.raises(ShardError, match=r"train-000001.*data.by_light=true"):
        mixed(sample, ORIGINAL)


def test_settings_of_data_sets_without_are_what_they_were():
    assert "by_light" not in replace(DATA, by_light=False).content()
    assert DATA.content()["by_light"] is True


def test_clamped_references_are_refused_before_blender_is_needed(sample):
    views = sample.c2w, sample.fov, 8, 8
    with pytest.raises(UserError, match=r"clamp_indirect=10.*unclamped"):
        render_lights(sample.triangles, *views, replace(REFERENCE, clamp_indirect=10.0))


def test_shards_hold_them(tmp_path):
    root = make(tmp_path / "apart", TwoLights(), render_lights=invented_lights, splits={"train": 2}, by_light=True).root
    scene = ShardSplit(root, "train")[1]
    np.testing.assert_array_equal(scene.lights.objects, [2, 3])
    assert ShardSplit(root, "train").read(1, by_light=False).lights is None
