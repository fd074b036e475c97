"""Samples round-trip in the stated precision; equal samples give equal bytes."""

from dataclasses import replace

import numpy as np
import pytest
from small_data import BoxFamily

from rfpp.errors import ShardError
from rfpp.raycast.first_hit import stack_channels
from rfpp.scene.camera import camera_to_world
from rfpp.scene.triangles import SceneTriangles
from rfpp.shards.sample import SCHEMA_VERSION, SceneSample, decode, encode
from rfpp.shards.scene_rays import SceneRays

STORED = (
    "normal", "roughness", "depth", "position", "albedo", "specular", "direct_diffuse", "direct_glossy",
    "reflected_light",
)  # fmt: skip


@pytest.fixture
def sample() -> SceneSample:
    scene = BoxFamily().sample(np.random.default_rng(1), np.random.default_rng(2), held_out=False)
    triangles = SceneTriangles.from_scene(scene)
    c2w = np.stack([camera_to_world(camera) for camera in scene.cameras])
    fov = np.array([camera.fov for camera in scene.cameras], np.float32)
    gbuffers = SceneRays(triangles).gbuffers(c2w, fov, 12, 2, np.random.SeedSequence(0))
    images = np.random.default_rng(3).exponential(0.5, (2, 12, 12, 3)).astype(np.float32)
    return SceneSample("train-000001", triangles, c2w, fov, images, gbuffers, {"family": "boxes", "index": 1})


def test_round_trip(sample):
    again = decode(sample.key, encode(sample))
    assert again.key == sample.key
    assert again.meta == sample.meta
    for name in ("positions", "material", "object_offsets", "object_names"):
        np.testing.assert_array_equal(getattr(again.triangles, name), getattr(sample.triangles, name))
    np.testing.assert_allclose(again.triangles.normals, sample.triangles.normals, atol=5e-4)
    np.testing.assert_array_equal(again.c2w, sample.c2w)
    np.testing.assert_array_equal(again.fov, sample.fov)
    np.testing.assert_allclose(again.images, sample.images, rtol=2**-11, atol=1e-7)
    assert again.images.dtype == again.triangles.normals.dtype == np.float32
    for stored, original in zip(again.gbuffers, sample.gbuffers, strict=True):
        np.testing.assert_array_equal(stored.triangle, original.triangle)
        np.testing.assert_array_equal(stored.depth, original.depth)
        np.testing.assert_allclose(stored.normal, original.normal, atol=5e-4)


def test_every_channel_of_a_stored_gbuffer_is_the_original(sample):
    again = decode(sample.key, encode(sample))
    for stored, original in zip(again.gbuffers, sample.gbuffers, strict=True):
        assert original.hit.any()
        assert stored.triangle.dtype == np.int32
        expected = stack_channels(original, sample.triangles.material, 45.0, STORED)
        got = stack_channels(stored, again.triangles.material, 45.0, STORED)
        np.testing.assert_allclose(got, expected, atol=5e-4, rtol=2**-11)


def test_stored_values_are_a_fixed_point_and_bytes_are_reproducible(sample):
    first = encode(sample)
    assert encode(sample) == first
    assert encode(decode(sample.key, first)) == first


def test_material_is_stored_per_object_unless_an_object_mixes_materials(sample):
    painted = sample.triangles.material.copy()
    painted[2:6, 0] = [0.1, 0.2, 0.3, 0.4]
    mixed = replace(sample, triangles=replace(sample.triangles, material=painted))
    assert len(encode(mixed)["geometry.safetensors"]) > len(encode(sample)["geometry.safetensors"])
    np.testing.assert_array_equal(decode("k", encode(mixed)).triangles.material, painted)


@pytest.mark.parametrize(("value", "message"), [(np.nan, "NaN"), (np.inf, "infinite"), (70000.0, "70000")])
def test_radiance_beyond_half_precision_is_an_error_that_names_scene_and_view(sample, value, message):
    images = sample.images.copy()
    images[1, 3, 4, 0] = value
    with pytest.raises(ShardError, match=f"train-000001: view 1.*{message}"):
        encode(replace(sample, images=images))


def test_missing_damaged_and_foreign_members_are_named(sample):
    members = encode(sample)
    without = {name: data for name, data in members.items() if name != "view1.exr"}
    with pytest.raises(ShardError, match=r"train-000001.*view1\.exr"):
        decode(sample.key, without)
    views = ("view0.exr", "view0.surface.exr", "view1.light.exr", "view1.reflection.exr")
    for name in (*views, "geometry.safetensors", "meta.json"):
        with pytest.raises(ShardError, match="train-000001"):
            decode(sample.key, {**members, name: members[name][: len(members[name]) // 2]})
    foreign = members["meta.json"].replace(b'"schema_version": %d' % SCHEMA_VERSION, b'"schema_version": 99')
    with pytest.raises(ShardError, match="schema version"):
        decode(sample.key, {**members, "meta.json": foreign})


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"triangle": np.full((12, 12), 999_999, np.int32)}, "a view refers to missing triangles"),
        ({"normal": np.zeros((9, 9, 3), np.float32), "depth": np.zeros((9, 9), np.float32),
          "triangle": np.full((9, 9), -1, np.int32)}, "the layers of a view differ in size"),
    ],
)  # fmt: skip
def test_inconsistent_arrays_are_refused(sample, part, message):
    first = sample.gbuffers[0]
    wrong = replace(sample, gbuffers=(replace(first, **part), *sample.gbuffers[1:]))
    with pytest.raises(ShardError, match=f"train-000001: a member is damaged .{message}"):
        decode(sample.key, encode(wrong))


def test_only_requested_views_and_channels_are_decoded(sample):
    members = encode(sample)
    whole = decode(sample.key, members)
    second = decode(sample.key, members, lambda views: [views - 1], channels=("albedo",))
    np.testing.assert_array_equal(second.images, whole.images[1:])
    np.testing.assert_array_equal(second.c2w, whole.c2w[1:])
    assert len(second.fov) == len(second.gbuffers) == 1
    np.testing.assert_array_equal(second.gbuffers[0].depth, whole.gbuffers[1].depth)
    assert second.gbuffers[0].light is None and second.gbuffers[0].reflection is None
    unused = ("view0", "view1.light", "view1.reflection")
    needed = {name: data for name, data in members.items() if not name.startswith(unused)}
    decode(sample.key, needed, lambda views: [1], channels=())
    with pytest.raises(ShardError, match=r"view1\.light\.exr"):
        decode(sample.key, needed, lambda views: [1])
