"""RenderFormer's H5 scenes: what is read, what is recovered, what is refused."""

import h5py
import numpy as np
import pytest
from known_scenes import look_at, still_life

from rfpp import Scene
from rfpp.errors import SceneError
from rfpp.scene.packed import PackedScene
from rfpp.scene.texture import FLAT_NORMAL, covered_cells, is_constant, mean_material

SCENE = still_life()


def patches(size: int = 32) -> np.ndarray:
    flat = np.broadcast_to(np.float32(FLAT_NORMAL), (len(SCENE), 3))
    values = np.concatenate([SCENE.material[:, :7], flat, SCENE.material[:, 7:]], axis=1)
    return (values[:, :, None, None] * covered_cells(size)).astype(np.float16)


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
    scene = Scene.load(write(tmp_path / "room.h5"))
    assert isinstance(scene, PackedScene)
    assert scene.name == "room" and scene.texture is None
    found = {t.tobytes(): i for i, t in enumerate(scene.triangles.positions)}
    order = [found[t.tobytes()] for t in SCENE.positions]
    np.testing.assert_array_equal(scene.triangles.normals[order], SCENE.normals)
    np.testing.assert_allclose(scene.triangles.material[order], SCENE.material, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(scene.fov, [40])


def test_connected_parts_of_one_material_become_objects(tmp_path):
    scene = Scene.load(write(tmp_path / "room.h5"))
    sizes = np.bincount(scene.triangles.object_index)
    # a floor, a ball, two lights, and a box whose twelve triangles all have a colour of their own
    assert sorted(sizes) == sorted([2, 1280, 1, 1, *[1] * 12])
    for index in range(scene.triangles.num_objects):
        material = scene.triangles.material[scene.triangles.object_index == index]
        assert (material == material[0]).all()


def test_varying_patches_are_kept_and_their_mean_is_the_material(tmp_path):
    texture = patches()
    texture[5, 0] *= np.linspace(0, 1, 32, dtype=np.float16)
    assert is_constant(patches()) and not is_constant(texture)
    scene = Scene.load(write(tmp_path / "textured.h5", texture=texture))
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
    ],
)
def test_what_does_not_fit_is_one_line_with_the_file(tmp_path, changes, message):
    path = write(tmp_path / "bad.h5", **changes)
    with pytest.raises(SceneError) as caught:
        Scene.load(path)
    assert str(path) in str(caught.value) and message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_hdf5_or_cut_off(tmp_path):
    path = tmp_path / "text.h5"
    path.write_text("hello")
    with pytest.raises(SceneError, match="cannot be read as HDF5"):
        Scene.load(path)
    whole = write(tmp_path / "whole.h5").read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SceneError, match="cannot be read as HDF5"):
        Scene.load(path)
    with pytest.raises(SceneError, match="cannot be read as HDF5"):
        Scene.load(tmp_path / "none.h5")
