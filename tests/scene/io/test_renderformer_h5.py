"""RenderFormer's H5 scenes: what is read, what is recovered, what is written, what is refused."""

import os
from dataclasses import replace

import h5py
import numpy as np
import pytest
from camera_rays import pixel_rays
from known_scenes import look_at, still_life

from rfpp.errors import SceneError
from rfpp.scene.io import renderformer_h5 as h5
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.renderformer_h5 import image_shape, load_images, save_h5
from rfpp.scene.packed import PackedScene
from rfpp.scene.texture import FLAT_NORMAL, covered_cells, is_constant, mean_material

SCENE = still_life()


def patches(size: int = 32, dtype: type = np.float16) -> np.ndarray:
    flat = np.broadcast_to(np.float32(FLAT_NORMAL), (len(SCENE), 3))
    values = np.concatenate([SCENE.material[:, :7], flat, SCENE.material[:, 7:]], axis=1)
    return (values[:, :, None, None] * covered_cells(size)).astype(dtype)


def write(path, **changes):
    arrays = {
        "triangles": SCENE.positions,
        "vn": SCENE.normals,
        "texture": patches(),
        "c2w": look_at((0.3, -1.5, 0.9))[None],
        "fov": np.array([40.0], np.float32),
    } | changes
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            if array is not None:
                file[name] = array
    return path


def test_a_patch_covers_its_triangle_and_nothing_else():
    covered = covered_cells(32)
    assert covered.sum() == 559
    assert covered[0, 31] and covered[31, 1] and covered[16, 16] and not covered[31, 2]


def test_triangles_materials_and_cameras_come_back(tmp_path):
    scene = load_scene(write(tmp_path / "room.h5"))
    assert isinstance(scene, PackedScene)
    assert scene.name == "room" and scene.texture is None
    found = {t.tobytes(): i for i, t in enumerate(scene.triangles.positions)}
    order = [found[t.tobytes()] for t in SCENE.positions]
    np.testing.assert_array_equal(scene.triangles.normals[order], SCENE.normals)
    np.testing.assert_allclose(scene.triangles.material[order], SCENE.material, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(scene.fov, [40])


def test_connected_parts_of_one_material_become_objects(tmp_path):
    scene = load_scene(write(tmp_path / "room.h5"))
    sizes = np.bincount(scene.triangles.object_index)
    # a floor, a ball, two lights, and a box whose twelve triangles all have a color of their own
    assert sorted(sizes) == sorted([2, 1280, 1, 1, *[1] * 12])
    for index in range(scene.triangles.num_objects):
        material = scene.triangles.material[scene.triangles.object_index == index]
        assert (material == material[0]).all()


def test_varying_patches_are_kept_and_their_mean_is_the_material(tmp_path):
    texture = patches()
    texture[5, 0] *= np.linspace(0, 1, 32, dtype=np.float16)
    assert is_constant(patches()) and not is_constant(texture)
    scene = load_scene(write(tmp_path / "textured.h5", texture=texture))
    row = next(i for i, t in enumerate(scene.triangles.positions) if np.array_equal(t, SCENE.positions[5]))
    np.testing.assert_array_equal(scene.texture[row], texture[5].astype(np.float32))
    expected = texture[5, 0].astype(np.float32)[covered_cells(32)].mean()
    assert scene.triangles.material[row, 0] == pytest.approx(expected, rel=1e-3)


def test_a_normal_map_or_a_value_outside_the_triangle_is_not_constant():
    bent, spilled = patches(), patches()
    bent[0, 7] = 0.6 * covered_cells(32)
    spilled[0, 0, 31, 31] = 0.5
    assert not is_constant(bent) and not is_constant(spilled)


def test_patches_of_a_single_cell(tmp_path):
    np.testing.assert_allclose(mean_material(patches(1)), SCENE.material, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"vn": None}, "the data set 'vn' is missing"),
        ({"vn": SCENE.normals[:5]}, "vn: shape"),
        ({"texture": patches()[:, :10]}, "texture: shape"),
        ({"fov": np.array([np.nan], np.float32)}, "fov: holds NaN"),
        ({"c2w": np.zeros((2, 4, 4), np.float32)}, "fov: shape"),
        ({"c2w": np.zeros((1, 4, 4), np.float32)}, "c2w: not a camera pose"),
        ({"c2w": 1e30 * look_at((1, 0, 0))[None]}, "c2w: not a camera pose"),
        ({"fov": np.float32([0])}, "fov: not between 0 and 180 degrees"),
        ({"fov": np.float32([1e30])}, "fov: not between 0 and 180 degrees"),
    ],
)
def test_what_does_not_fit_is_one_line_with_the_file(tmp_path, changes, message):
    path = write(tmp_path / "bad.h5", **changes)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert str(path) in str(caught.value) and message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_hdf5_or_cut_off(tmp_path):
    path = tmp_path / "text.h5"
    path.write_text("hello")
    with pytest.raises(SceneError, match="cannot be read as HDF5"):
        load_scene(path)
    whole = write(tmp_path / "whole.h5").read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SceneError, match="cannot be read as HDF5"):
        load_scene(path)
    with pytest.raises(SceneError, match="cannot be read as HDF5"):
        load_scene(tmp_path / "none.h5")


def test_a_written_scene_is_read_back(tmp_path):
    scene = PackedScene("room", SCENE, look_at((0.3, -1.5, 0.9))[None], np.array([40.0], np.float32))
    again = load_scene(save_h5(scene, tmp_path / "new" / "room.h5"))
    for name in ("positions", "normals", "object_offsets"):
        np.testing.assert_array_equal(getattr(again.triangles, name), getattr(SCENE, name))
    np.testing.assert_array_equal(again.triangles.material, SCENE.material.astype(np.float16))
    np.testing.assert_array_equal(again.c2w, scene.c2w)
    np.testing.assert_array_equal(again.fov, scene.fov)
    assert again.texture is None


def test_varying_patches_survive_being_written(tmp_path):
    texture = patches()
    texture[5, 0] *= np.linspace(0, 1, 32, dtype=np.float16)
    scene = load_scene(write(tmp_path / "textured.h5", texture=texture))
    again = load_scene(save_h5(scene, tmp_path / "again.h5"))
    np.testing.assert_array_equal(again.texture, scene.texture)
    np.testing.assert_array_equal(again.triangles.positions, scene.triangles.positions)


def test_patches_are_written_as_the_layout_has_them(tmp_path):
    scene = PackedScene("room", SCENE, look_at((0.3, -1.5, 0.9))[None], np.array([40.0], np.float32))
    with h5py.File(save_h5(scene, tmp_path / "room.h5")) as file:
        np.testing.assert_array_equal(file["texture"], patches())
        found = {name: (file[name].dtype, file[name].shape) for name in file}
        assert file["texture"].id.get_storage_size() < file["texture"].nbytes / 50
    assert found == {
        "triangles": ("f4", (len(SCENE), 3, 3)),
        "vn": ("f4", (len(SCENE), 3, 3)),
        "texture": ("f2", (len(SCENE), 13, 32, 32)),
        "c2w": ("f4", (1, 4, 4)),
        "fov": ("f4", (1,)),
        "object_index": ("i4", (len(SCENE),)),
    }


def test_images_are_linear_half_precision_with_channels_last(tmp_path):
    images = np.random.default_rng(0).exponential(2.0, (1, 6, 6, 3)).astype(np.float32)
    scene = PackedScene("room", SCENE, look_at((0.3, -1.5, 0.9))[None], np.array([40.0], np.float32))
    path = save_h5(scene, tmp_path / "room.h5", images)
    assert image_shape(path) == (1, 6, 6)
    np.testing.assert_array_equal(load_images(path), images.astype(np.float16))
    with_alpha = np.concatenate([images, np.ones((1, 6, 6, 1))], axis=-1).astype(np.float16)
    np.testing.assert_array_equal(load_images(write(tmp_path / "rgba.h5", img=with_alpha)), images.astype(np.float16))


def test_the_projection_puts_points_where_the_camera_sees_them(tmp_path):
    pose, height, width = look_at((0.3, -1.5, 0.9)), 6, 12
    scene = PackedScene("room", SCENE, pose[None], np.array([40.0], np.float32))
    path = save_h5(scene, tmp_path / "room.h5", np.zeros((1, height, width, 3), np.float32))
    origins, directions = pixel_rays(pose, 40.0, height, width)
    points = np.concatenate([origins + 1.3 * directions, np.ones((height, width, 1))], axis=-1)
    with h5py.File(path) as file:
        clip = points @ file["mvp"][0].T.astype(np.float64)
    x, y, depth = np.moveaxis(clip[..., :3] / clip[..., 3:], -1, 0)
    np.testing.assert_allclose(x, np.broadcast_to((np.arange(width) + 0.5) / width * 2 - 1, x.shape), atol=1e-5)
    np.testing.assert_allclose(y.T, np.broadcast_to((np.arange(height) + 0.5) / height * 2 - 1, y.T.shape), atol=1e-5)
    assert (np.abs(depth) < 1).all()


def test_what_half_precision_cannot_hold_is_not_written(tmp_path):
    bright = replace(SCENE, material=np.where(SCENE.material > 1000, 1e5, SCENE.material).astype(np.float32))
    scene = PackedScene("room", bright, look_at((0.3, -1.5, 0.9))[None], np.array([40.0], np.float32))
    with pytest.raises(SceneError, match=r"room\.h5: material: 100000 cannot be stored"):
        save_h5(scene, tmp_path / "room.h5")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, "the data set 'img' is missing"),
        ({"img": np.zeros((2, 6, 6, 3), np.float16)}, "img: shape"),
        ({"img": np.zeros((1, 3, 6, 6), np.float16)}, "img: shape"),
        ({"img": np.full((1, 6, 6, 3), np.nan, np.float16)}, "img: holds NaN"),
    ],
)
def test_images_that_are_missing_or_wrong_are_named(tmp_path, changes, message):
    path = write(tmp_path / "bad.h5", **changes)
    with pytest.raises(SceneError, match=message) as caught:
        load_images(path)
    assert str(path) in str(caught.value)


def test_objects_that_are_not_one_per_triangle_are_refused(tmp_path):
    path = write(tmp_path / "bad.h5", object_index=np.zeros(3, np.int32))
    with pytest.raises(SceneError, match=r"bad\.h5: object_index: int32 \(3,\)"):
        load_scene(path)


def test_patches_are_read_piece_by_piece(tmp_path, monkeypatch):
    monkeypatch.setattr(h5, "_SLAB", 100)
    whole = PackedScene("room", SCENE, look_at((0.3, -1.5, 0.9))[None], np.array([40.0], np.float32))
    for path in (write(tmp_path / "room.h5"), save_h5(whole, tmp_path / "chunked.h5")):
        materials = {t.tobytes(): m for t, m in zip(SCENE.positions, SCENE.material.astype(np.float16), strict=True)}
        scene = load_scene(path)
        found = zip(scene.triangles.positions, scene.triangles.material, strict=True)
        assert all(np.array_equal(materials[t.tobytes()], m) for t, m in found)


def test_absurd_sizes_are_not_believed(tmp_path):
    path = write(tmp_path / "absurd.h5")
    for name, shape in (
        ("triangles", (10**9, 3, 3)),
        ("c2w", (10**8, 4, 4)),
        ("texture", (len(SCENE), 13, 9999, 9999)),
    ):
        with h5py.File(path, "a") as file:
            kept = file[name][()]
            del file[name]
            file.create_dataset(name, shape, np.float32, chunks=True)  # nothing is stored of it
        with pytest.raises(SceneError, match=rf"absurd\.h5: {name}: claims [\d,]+ bytes, more than it holds"):
            load_scene(path)
        with h5py.File(path, "a") as file:
            del file[name]
            file[name] = kept


def test_nothing_is_read_from_other_files(tmp_path):
    whole, path = write(tmp_path / "whole.h5"), write(tmp_path / "linked.h5")
    (tmp_path / "raw").write_bytes(SCENE.positions.astype(np.float32).tobytes())
    layout = h5py.VirtualLayout(SCENE.positions.shape, np.float32)
    layout[:] = h5py.VirtualSource(whole, "triangles", SCENE.positions.shape)
    ways = [
        lambda file: file.__setitem__("triangles", h5py.ExternalLink(str(whole), "triangles")),
        lambda file: file.create_virtual_dataset("triangles", layout),
        lambda file: file.create_dataset(
            "triangles", SCENE.positions.shape, np.float32, external=[(str(tmp_path / "raw"), 0, h5py.h5f.UNLIMITED)]
        ),
    ]
    for way in ways:
        with h5py.File(path, "a") as file:
            del file["triangles"]
            way(file)
        with pytest.raises(SceneError, match=r"linked\.h5: triangles: its content lies in another file"):
            load_scene(path)


@pytest.mark.timeout(20)
def test_nothing_waits_for_a_pipe(tmp_path):
    pipe, path = tmp_path / "pipe.h5", write(tmp_path / "linked.h5")
    os.mkfifo(pipe)
    with h5py.File(path, "a") as file:
        del file["triangles"]
        file["triangles"] = h5py.ExternalLink(str(pipe), "triangles")
    with pytest.raises(SceneError, match=r"linked\.h5: triangles: its content lies in another file"):
        load_scene(path)
    with pytest.raises(SceneError, match=r"pipe\.h5: is not a regular file"):
        load_scene(pipe)
