"""Export of samples: round trips, documented losses, and refused input."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from known_scenes import look_at as pose_of
from known_scenes import still_life
from scene_families import scenes
from stored_sample import stored_sample

from rfpp.errors import SceneError, UserError
from rfpp.imaging.exr import read_exr
from rfpp.raycast.first_hit import channel, object_ids
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.renderformer_h5 import load_images
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.triangles import DIFFUSE, SPECULAR, SceneTriangles
from rfpp.shards.export import export


@pytest.fixture(scope="module")
def sample():
    """Sample of a scene with flat and smooth objects of procedural shapes."""
    return stored_sample(pack(scenes("quickstart", 2)[1]))


@pytest.fixture(scope="module")
def painted():
    """Sample of a scene with a box whose triangles have different colors."""
    pose = pose_of((0.3, -1.5, 0.9))
    return stored_sample(PackedScene("still life", still_life(), pose[None], np.array([40.0], np.float32)))


def as_set(triangles: SceneTriangles) -> list:
    """Return positions and materials of the triangles in an order independent of theirs."""
    rows = np.concatenate([triangles.positions.reshape(-1, 9), triangles.material], axis=1)
    return rows[np.lexsort(rows.T)].tolist()


def test_json_restores_triangles_materials_normals_and_cameras(sample, tmp_path):
    scene = pack(load_scene(export(sample, "renderformer", tmp_path)[0]))
    assert scene.name == sample.key
    for name in ("positions", "material", "object_offsets", "object_names"):
        np.testing.assert_array_equal(getattr(scene.triangles, name), getattr(sample.triangles, name))
    np.testing.assert_allclose(scene.triangles.normals, sample.triangles.normals, atol=5e-4)  # stored in half precision
    np.testing.assert_allclose(scene.c2w, sample.c2w, atol=1e-6)
    np.testing.assert_array_equal(scene.fov, sample.fov)


def test_an_object_of_many_materials_becomes_many_objects_of_the_same_triangles(painted, tmp_path):
    scene = pack(load_scene(export(painted, "renderformer", tmp_path)[0]))
    assert scene.triangles.num_objects == painted.triangles.num_objects - 1 + 12
    assert as_set(scene.triangles) == as_set(painted.triangles)


def test_triangles_without_area_are_omitted(painted, tmp_path):
    positions = painted.triangles.positions.copy()
    positions[4, 2] = positions[4, 1]
    flattened = replace(painted, triangles=replace(painted.triangles, positions=positions))
    scene = pack(load_scene(export(flattened, "renderformer", tmp_path)[0]))
    assert len(scene.triangles) == len(positions) - 1


def test_an_invalid_material_is_named(painted, tmp_path):
    material = painted.triangles.material.copy()
    material[0:2, 0] = 1.5
    wrong = replace(painted, triangles=replace(painted.triangles, material=material))
    with pytest.raises(SceneError, match=r"object 'object_0': material\.diffuse"):
        export(wrong, "renderformer", tmp_path)


def test_h5_restores_triangles_objects_cameras_and_images(sample, tmp_path):
    path = export(sample, "h5", tmp_path)[0]
    scene = load_scene(path)
    for name in ("positions", "normals", "object_offsets"):
        np.testing.assert_array_equal(getattr(scene.triangles, name), getattr(sample.triangles, name))
    np.testing.assert_array_equal(scene.triangles.material, sample.triangles.material.astype(np.float16))
    np.testing.assert_array_equal(scene.c2w, sample.c2w)
    np.testing.assert_array_equal(scene.fov, sample.fov)
    np.testing.assert_array_equal(load_images(path), sample.images)


def test_h5_without_our_objects_still_holds_the_same_triangles(sample, tmp_path):
    path = export(sample, "h5", tmp_path)[0]
    with h5py.File(path, "r+") as file:
        del file["object_index"]
    stored = replace(sample.triangles, material=sample.triangles.material.astype(np.float16).astype(np.float32))
    assert as_set(load_scene(path).triangles) == as_set(stored)


def test_exr_shows_the_image_and_adds_the_gbuffers(sample, tmp_path):
    paths = export(sample, "exr", tmp_path)
    assert [path.name for path in paths] == [f"train-000001.view{view}.exr" for view in range(len(sample.fov))]
    for path, image, gbuffer, fov in zip(paths, sample.images, sample.gbuffers, sample.fov, strict=True):
        layers = read_exr(path)
        material = sample.triangles.material[gbuffer.triangle]
        direct = material[..., DIFFUSE] * gbuffer.light.diffuse + material[..., SPECULAR] * gbuffer.light.glossy
        np.testing.assert_array_equal(layers["RGB"], image)
        np.testing.assert_allclose(layers["direct"], np.where(gbuffer.hit[..., None], direct, 0), rtol=1e-6)
        np.testing.assert_array_equal(layers["depth"], gbuffer.depth)
        np.testing.assert_array_equal(layers["triangle"], gbuffer.triangle + 1)
        np.testing.assert_array_equal(layers["object"], object_ids(gbuffer, sample.triangles) + 1)
        np.testing.assert_allclose(
            layers["roughness"], channel(gbuffer, sample.triangles.material, fov, "roughness")[..., 0], rtol=1e-3
        )


def test_equal_samples_are_equal_files(sample, tmp_path):
    for name in ("a", "b"):
        for format in ("renderformer", "h5", "exr"):
            export(sample, format, tmp_path / name)
    content = [
        {
            path.relative_to(tmp_path / name): path.read_bytes()
            for path in (tmp_path / name).rglob("*")
            if path.is_file()
        }
        for name in ("a", "b")
    ]
    assert content[0] == content[1]


def test_an_unknown_format_lists_the_known(sample, tmp_path):
    with pytest.raises(UserError, match="format=gltf: choose from renderformer, h5, exr"):
        export(sample, "gltf", tmp_path)
