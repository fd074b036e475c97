"""Any scene: which reader, folders, budgets, and what is refused by its name alone."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rfpp import Scene
from rfpp.errors import SceneError
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.saving import save_scene
from rfpp.scene.mesh import Mesh, decimated
from rfpp.scene.packed import pack
from rfpp.scene.spec import Material, SceneObject, Transform

pytestmark = pytest.mark.filterwarnings("ignore:.*(scaled by|no camera|no light|names no MTL)")


@pytest.mark.parametrize(
    ("name", "fix"),
    [
        ("scene.dae", "open it in Blender and export glTF"),
        ("scene.3MF", "open it in Blender and export glTF"),
        ("scene.x3d", "open it in Blender and export glTF"),
        ("scene.svg", "open it in Blender and export glTF"),
        ("scene.fbx", "open it in Blender and export glTF"),
        ("scene.blend", "open it in Blender and export glTF"),
        ("scene.usdz", "open it in Blender and export glTF"),
        ("scene.png", r"unsupported scene format '\.png': give \.json, "),
    ],
)
def test_other_formats_are_refused_unopened(name: str, fix: str, tmp_path: Path) -> None:
    bomb = '<!DOCTYPE a [<!ENTITY b "bbbbbbbb"><!ENTITY c "&b;&b;&b;">]><a>&c;</a>'
    (tmp_path / name).write_text(bomb)
    with pytest.raises(SceneError, match=fix) as caught:
        load_scene(tmp_path / name)
    assert str(caught.value).startswith(f"{tmp_path / name}: ")


@pytest.mark.parametrize("name", ["gone.glb", "gone.obj", "gone.ply", "gone.stl", "gone.json", "gone.gltf"])
def test_missing_and_empty_files_are_named(name: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=rf"{name}: cannot be read \(No such file"):
        load_scene(tmp_path / name)
    (tmp_path / name).touch()
    with pytest.raises(SceneError, match=rf"{name}: is empty"):
        load_scene(tmp_path / name)


def test_files_too_large_to_be_read_are_refused_unread(tmp_path: Path) -> None:
    for name in ("a.json", "a.gltf", "a.glb", "a.obj", "a.ply", "a.stl"):
        with (tmp_path / name).open("wb") as file:
            file.truncate(2**40)  # takes no room: it is all hole
        with pytest.raises(SceneError, match=rf"{name}: holds 1,099,511,627,776 bytes, the limit is"):
            load_scene(tmp_path / name)


def test_a_device_is_no_scene(tmp_path: Path) -> None:
    (tmp_path / "endless.glb").symlink_to("/dev/zero")
    with pytest.raises(SceneError, match="is not a regular file"):
        load_scene(tmp_path / "endless.glb")


def test_a_folder_is_one_scene_of_all_its_meshes(tmp_path: Path) -> None:
    trimesh.creation.box().export(tmp_path / "a.ply")
    trimesh.creation.box().apply_translation([3, 0, 0]).export(tmp_path / "b.stl")
    trimesh.creation.box().apply_translation([0, 0, 3]).export(tmp_path / "c.glb")  # glTF's z is the world's -y
    (tmp_path / "notes.txt").write_text("not a mesh")
    scene = load_scene(tmp_path)
    assert scene.name == tmp_path.name
    low, high = (f(pack(scene).triangles.positions[:36], axis=(0, 1)) for f in (np.min, np.max))
    np.testing.assert_allclose(high - low, [1, 1, 0.25], atol=1e-6)
    assert [item.name for item in scene.objects][:2] == ["a", "b"]


def test_folders_without_meshes_or_with_a_bad_one_are_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=f"{tmp_path}: holds no mesh: give a folder of"):
        load_scene(tmp_path)
    (tmp_path / "bad.stl").write_bytes(b"x")
    with pytest.raises(SceneError, match=rf"{tmp_path}: bad\.stl: is neither text nor"):
        load_scene(tmp_path)


def ball_file(folder: Path, subdivisions: int = 4) -> Path:
    path = folder / "ball.ply"
    trimesh.creation.icosphere(subdivisions).export(path)
    return path


def test_a_budget_is_kept_and_says_what_it_cost(tmp_path: Path) -> None:
    path = ball_file(tmp_path)
    with pytest.warns(UserWarning, match=r"ball\.ply: 5,123 triangles were reduced to \d{3}$"):
        scene = load_scene(path, triangles=600, backdrop="none")
    triangles = pack(scene).triangles
    assert 500 < len(triangles) <= 600
    solid = triangles.positions[~triangles.is_emissive]
    np.testing.assert_allclose(np.linalg.norm(solid, axis=-1), 0.5, rtol=0.02)
    assert triangles.is_emissive.sum() == 3  # lights are kept
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*reduced")
        assert len(pack(load_scene(path, triangles=6000, backdrop="none")).triangles) == 5123


def test_what_cannot_be_reduced_keeps_more_and_larger_objects_fewer(tmp_path: Path, monkeypatch) -> None:
    def stubborn(mesh: Mesh, target: int) -> Mesh:
        if len(mesh) == 80 and target < 50:
            raise SceneError("the mesh cannot be reduced")
        return decimated(mesh, target)

    monkeypatch.setattr("rfpp.scene.budget.decimated", stubborn)
    (tmp_path / "balls").mkdir()
    for name, subdivisions in (("small", 1), ("large", 4)):
        trimesh.creation.icosphere(subdivisions).export(tmp_path / "balls" / f"{name}.stl")
    with pytest.warns(UserWarning, match="were reduced to"):
        scene = load_scene(tmp_path / "balls", triangles=400)
    sizes = {item.name: len(item.mesh) for item in scene.objects}
    assert 25 < sizes["small"] <= 80 and sizes["large"] > 200
    assert sum(sizes.values()) <= 400
    with pytest.raises(SceneError, match=r"balls: cannot be reduced to triangles=40: its objects keep \d+: give more"):
        load_scene(tmp_path / "balls", triangles=40)


def test_impossible_budgets_say_the_least(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"ball\.ply: triangles=5 is too few for 4 objects: give at least 7"):
        load_scene(ball_file(tmp_path), triangles=5, backdrop="none")
    with pytest.raises(SceneError, match="triangles=0: give at least 1"):
        load_scene(ball_file(tmp_path), triangles=0)


def test_an_axis_that_is_none_is_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="up=x: choose y or z"):
        load_scene(ball_file(tmp_path), up="x")


def test_decimated_faces_keep_the_colors_of_their_place(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(4)
    upper = mesh.triangles_center[:, 2] > 0
    mesh.visual.face_colors = np.where(upper[:, None], [255, 0, 0, 255], [0, 0, 255, 255])
    mesh.export(tmp_path / "two.ply")
    with pytest.warns(UserWarning, match="reduced"):
        triangles = pack(load_scene(tmp_path / "two.ply", triangles=800, backdrop="none")).triangles
    solid = ~triangles.is_emissive
    heights, red = triangles.positions[solid].mean(axis=1)[:, 2], triangles.material[solid, 0] > 0.5
    clear = np.abs(heights) > 0.05
    np.testing.assert_array_equal(red[clear], heights[clear] > 0)


def test_a_budget_also_holds_for_json_and_not_for_h5(tmp_path: Path) -> None:
    mesh = load_scene(ball_file(tmp_path)).objects[0].mesh
    gray = Material(diffuse=(0.5,) * 3, specular=(0,) * 3, roughness=1)
    scene = Scene(objects=(SceneObject(name="a", mesh=mesh, material=gray, transform=Transform()),))
    with pytest.warns(UserWarning, match=r"a\.json: 5,120 triangles were reduced"):
        assert len(load_scene(save_scene(scene, tmp_path / "a.json"), triangles=500).objects[0].mesh) <= 500
    path = save_scene(scene, tmp_path / "a.h5")
    with pytest.raises(SceneError, match="H5 scenes are not decimated"):
        load_scene(path, triangles=500)


def test_objects_turn_about_themselves(tmp_path: Path) -> None:
    (tmp_path / "two.ply").write_bytes(
        trimesh.util.concatenate(
            [trimesh.creation.box(), trimesh.creation.box().apply_translation([4, 0, 0])]
        ).export(file_type="ply")
    )  # fmt: skip
    first, second, *_ = load_scene(tmp_path / "two.ply").objects
    for item, x in ((first, -0.4), (second, 0.4)):
        np.testing.assert_allclose(item.mesh.vertices.mean(axis=0), 0, atol=1e-6)
        np.testing.assert_allclose(item.transform.translation, [x, 0, 0], atol=1e-6)


def test_coordinates_far_from_the_origin_keep_their_detail(tmp_path: Path) -> None:
    (tmp_path / "survey.obj").write_text(
        "".join(f"v {431234.5 + x} 0 {5412345.25 + z}\n" for x, z in ((0, 0), (0.125, 0), (0, 0.25))) + "f 1 2 3\n"
    )
    (item, *_) = load_scene(tmp_path / "survey.obj").objects
    np.testing.assert_allclose(np.ptp(item.mesh.vertices, axis=0), [0.5, 1, 0], atol=1e-6)


def test_parts_without_area_are_left_out_with_a_notice(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 0 1\no line\nf 1 2 2\no plane\nf 1 2 3\n")
    with pytest.warns(UserWarning, match=r"'line' has no area and is omitted"):
        assert load_scene(tmp_path / "a.obj").objects[0].name == "plane"


def test_large_scenes_are_told_how_to_become_smaller(tmp_path: Path) -> None:
    trimesh.creation.icosphere(7).export(tmp_path / "fine.ply")
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*of training scenes")
        load_scene(tmp_path / "fine.ply", triangles=1000, backdrop="none")
    with pytest.warns(
        UserWarning, match=r"327,683 triangles, more than the 80,000 of training scenes: triangles=80000 reduces them"
    ):
        load_scene(tmp_path / "fine.ply", backdrop="none")


PARTS = b"".join(b"o %d\nf 1 2 3\n" % i for i in range(20_001))
MANY = {
    "nodes.gltf": (b'{"asset": {"version": "2.0"}, "nodes": [' + b"{}," * 200_000 + b"{}]}",
                   "nodes: a list of at most 100,000"),
    "nested.gltf": (b'{"asset": ' + b"[" * 100_000, "nested too deeply"),
    "groups.obj": (b"v 0 0 0\n" * 3 + PARTS, "more than 20,000 parts"),
    "materials.obj": (b"mtllib many.mtl\n" + b"v 0 0 0\n" * 3 + b"f 1 2 3\n",
                      r"many\.mtl: line 20001: more than 20,000 parts"),
    "objects.json": (b'{"version": "1.0", "objects": {' + b",".join(b'"%d": {}' % i for i in range(20_001)) + b"}}",
                     "objects: 20,001 are more than 20,000"),
    "cameras.json": (b'{"version": "1.0", "objects": {}, "cameras": [' + b"{}," * 30_000 + b"{}]}",
                     "cameras: 30,001 are more than 20,000"),
}  # fmt: skip


@pytest.mark.parametrize("name", MANY)
def test_absurdly_many_entries_are_refused_before_they_are_made(name: str, tmp_path: Path) -> None:
    content, message = MANY[name]
    (tmp_path / name).write_bytes(content)
    (tmp_path / "many.mtl").write_bytes(b"".join(b"newmtl %d\n" % i for i in range(20_001)))
    with pytest.raises(SceneError, match=rf"{name}: .*{message}"):
        load_scene(tmp_path / name)
