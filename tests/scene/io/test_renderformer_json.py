"""Scene files: RenderFormer JSON v1.0."""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rfpp.errors import SceneError, UserError
from rfpp.scene.io import renderformer_json
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.renderformer_json import load_json
from rfpp.scene.io.saving import save_scene
from rfpp.scene.mesh import Mesh, decimated
from rfpp.scene.spec import Camera, Material, Scene, SceneObject, Transform
from rfpp.scene.triangles import SceneTriangles

EXAMPLES = Path(__file__).parents[3] / "data" / "scenes"
PLAIN = {
    "scene_name": "plain",
    "version": "1.0",
    "objects": {
        "ball": {
            "mesh_path": "ball.obj",
            "material": {"diffuse": [0.5, 0.5, 0.5], "specular": [0, 0, 0], "roughness": 0.5},
        }
    },
    "cameras": [{"position": [0, -2, 0], "look_at": [0, 0, 0], "up": [0, 0, 1], "fov": 40}],
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    trimesh.creation.icosphere(3).export(tmp_path / "ball.obj")
    return tmp_path


def write(folder: Path, content: object) -> Path:
    path = folder / "scene.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def changed(change: Callable[[dict], object]) -> dict:
    content = copy.deepcopy(PLAIN)
    change(content)
    return content


def test_absent_keys_have_the_defaults_of_the_format(folder: Path) -> None:
    scene = load_scene(write(folder, PLAIN))
    (item,) = scene.objects
    assert (scene.name, item.name, len(item.mesh)) == ("plain", "ball", 1280)
    assert item.transform == Transform(translation=(0, 0, 0), rotation=(0, 0, 0), scale=(1, 1, 1), normalize=True)
    assert item.material.emissive == (0, 0, 0)
    assert not item.material.smooth_shading
    assert item.material.rand_tri_diffuse_seed is None
    assert item.material.random_diffuse_type == "per-shading-group"


def test_a_byte_order_mark_is_skipped(folder: Path) -> None:
    path = write(folder, PLAIN)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert load_scene(path).name == "plain"


def test_meshes_are_found_beside_the_file_and_below(folder: Path, monkeypatch) -> None:
    (folder / "sub").mkdir()
    (folder / "ball.obj").rename(folder / "sub" / "ball.obj")
    monkeypatch.chdir("/")
    path = write(folder, changed(lambda c: c["objects"]["ball"].update(mesh_path="sub/ball.obj")))
    assert len(load_json(path).objects[0].mesh) == 1280


@pytest.mark.parametrize("escape", ["../ball.obj", "sub/../../ball.obj", "{}/ball.obj", "..\\ball.obj", "C:/ball.obj"])
def test_a_mesh_outside_the_folder_is_refused_though_it_is_there(folder: Path, escape: str) -> None:
    (folder / "inner" / "sub").mkdir(parents=True)
    path = write(
        folder / "inner", changed(lambda c: c["objects"]["ball"].update(mesh_path=escape.format(folder.as_posix())))
    )
    with pytest.raises(SceneError, match=r"object 'ball': .*leads out of the file's folder: copy it there"):
        load_scene(path)


def test_a_mesh_behind_a_link_is_found(folder: Path) -> None:
    (folder / "inner").mkdir()
    (folder / "inner" / "ball.obj").symlink_to(folder / "ball.obj")
    assert len(load_scene(write(folder / "inner", PLAIN)).objects[0].mesh) == 1280


def test_copies_of_a_mesh_are_reduced_once_and_too_many_reductions_are_refused(folder: Path, monkeypatch) -> None:
    calls = []
    monkeypatch.setattr(
        renderformer_json, "decimated", lambda mesh, target: calls.append(target) or decimated(mesh, target)
    )

    def of_targets(*targets: int) -> Path:
        ball = PLAIN["objects"]["ball"] | {"remesh": True}
        balls = {f"ball {i}": ball | {"remesh_target_face_num": target} for i, target in enumerate(targets)}
        return write(folder, changed(lambda c: c.update(objects=balls)))

    assert len(load_scene(of_targets(200, 200, 300, 200)).objects) == 4
    assert calls == [200, 300]
    monkeypatch.setattr(renderformer_json, "MAX_TRIANGLES", 3000)
    with pytest.raises(SceneError, match=r"scene.json: object 'ball 2': meshes of more than 3,000 faces"):
        load_scene(of_targets(200, 300, 400))


@pytest.mark.parametrize(("target", "most"), [({}, 1280), ({"remesh_target_face_num": 200}, 200)])
def test_remesh_reduces_to_the_budget(folder: Path, target: dict, most: int) -> None:
    path = write(folder, changed(lambda c: c["objects"]["ball"].update(remesh=True, **target)))
    assert most * 0.9 <= len(load_json(path).objects[0].mesh) <= most


def at(*keys: str | int, value: object) -> dict:
    """The plain scene with one value replaced or added."""
    content = copy.deepcopy(PLAIN)
    place = content
    for key in keys[:-1]:
        place = place.setdefault(key, {}) if isinstance(place, dict) else place[key]
    place[keys[-1]] = value
    return content


BALL = ("objects", "ball")
BAD_SCENES = {
    "key at the top": (at("sky", value=1), r"sky: unknown key"),
    "key of an object": (at(*BALL, "meshpath", value="x"), r"object 'ball': meshpath: unknown key"),
    "key of a material": (at(*BALL, "material", "metal", value=1), r"object 'ball': material\.metal: unknown key"),
    "key of a transform": (at(*BALL, "transform", "rot", value=1), r"object 'ball': transform\.rot: unknown key"),
    "key of a camera": (at("cameras", 0, "zoom", value=1), r"cameras\.0: camera\.zoom: unknown key"),
    "other version": (at("version", value="2.0"), r"version: '2\.0' cannot be read, only '1\.0'"),
    "no version": (changed(lambda c: c.pop("version")), r"version: this key is missing"),
    "no objects": (at("objects", value={}), r"scene: objects: the scene is empty"),
    "objects as list": (at("objects", value=[]), r"objects: "),
    "no mesh": (changed(lambda c: c["objects"]["ball"].pop("mesh_path")), r"'ball': mesh_path: this key is missing"),
    "missing mesh": (at(*BALL, "mesh_path", value="gone.obj"), r"object 'ball': .*gone\.obj: there is no such mesh"),
    "bright": (at(*BALL, "material", "diffuse", value=[0, 1.5, 0]), r"'ball': material\.diffuse\.1: .*not 1\.5"),
    "dark": (at(*BALL, "material", "specular", value=[0, -1, 0]), r"'ball': material\.specular\.1: "),
    "NaN": (at(*BALL, "material", "roughness", value=float("nan")), r"material\.roughness: .*not nan"),
    "remesh to nothing": (at(*BALL, "remesh_target_face_num", value=0), r"'ball': remesh_target_face_num: "),
    "looks nowhere": (at("cameras", 0, "look_at", value=[0, -2, 0]), r"cameras\.0: camera: look_at equals position"),
    "no fov": (changed(lambda c: c["cameras"][0].pop("fov")), r"cameras\.0: camera\.fov: this key is missing"),
    "line": ('{\n  "version": "1.0",\n  "objects": {,}\n}', r"line 3: malformed JSON"),
    "repeated": ('{"version": "1.0", "objects": {"a": 1, "a": 2}}', r"the key 'a' occurs twice"),
    "list": ("[]", r"is not a JSON object"),
    "nothing": ("", r"is empty"),
    "nested": ("[" * 100_000, r"nested too deeply"),
    "nested objects": ('{"a":' * 100_000, r"nested too deeply"),
    "digits": ('{"version": ' + "1" * 10_000 + "}", r"thousands of digits"),
    "URL": (at(*BALL, "mesh_path", value="http://x.org/ball.obj"), r"is not a file path"),
    "line in a name": (at("objects", "a\nb", value={}), r"object 'a b': the name 'a b' has characters that cannot"),
    "half a character": (at("scene_name", value="\ud800"), r"the name ' ' has characters that cannot be printed"),
}


@pytest.mark.parametrize("case", BAD_SCENES)
def test_a_bad_scene_is_one_line_naming_the_file(folder: Path, case: str) -> None:
    content, message = BAD_SCENES[case]
    path = write(folder, content)
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("vertex", "face", "message"),
    [("v 0 1 0", "f 1 2 9", "index 8 is out of bounds"), ("v nan 1 0", "f 1 2 3", "'v nan 1 0' cannot be read")],
)
def test_a_bad_mesh_names_scene_object_and_mesh(folder: Path, vertex: str, face: str, message: str) -> None:
    (folder / "ball.obj").write_text(f"v 0 0 0\nv 1 0 0\n{vertex}\n{face}\n")
    with pytest.raises(SceneError, match=rf"scene\.json: object 'ball': .*ball\.obj: .*{message}"):
        load_scene(write(folder, PLAIN))


@pytest.mark.parametrize(
    ("faces", "transform", "message"),
    [
        ("f 1 1 2", {"normalize": False}, "zero area"),
        ("f 4 5 6", {}, "all vertices coincide"),
        ("f 1 2 3", {"scale": [0, 0, 0]}, "zero area"),
    ],
)
def test_what_leaves_nothing_where_it_stands_is_named(folder: Path, faces: str, transform: dict, message: str) -> None:
    vertices = "v 7 7 7\n" * 3 if "4" in faces else "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    (folder / "ball.obj").write_text(f"{vertices}{faces.replace('4 5 6', '1 2 3')}\n")
    with pytest.raises(SceneError, match=rf"scene\.json: object 'ball': .*{message}"):
        load_scene(write(folder, changed(lambda c: c["objects"]["ball"].update(transform=transform))))


def test_a_missing_or_binary_scene_is_named(folder: Path) -> None:
    with pytest.raises(SceneError, match=r"gone\.json: cannot be read \(No such file or directory\)"):
        load_scene(folder / "gone.json")
    (folder / "binary.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SceneError, match=r"binary\.json: is not UTF-8"):
        load_scene(folder / "binary.json")


def test_above_one_only_warns(folder: Path) -> None:
    with pytest.warns(UserWarning, match="object 'ball': diffuse"):
        load_scene(write(folder, at(*BALL, "material", "specular", value=[0.6, 0.6, 0.6])))


def varied_scene() -> Scene:
    ball, torus = trimesh.creation.icosphere(1), trimesh.creation.torus(1, 0.3)
    ball, torus = Mesh(ball.vertices, ball.faces), Mesh(torus.vertices, torus.faces)
    gray = Material(diffuse=(0.1, 0.2, 0.3), specular=(0.3, 0.3, 0.3), roughness=0.123)
    random = gray.model_copy(update={"rand_tri_diffuse_seed": 0, "smooth_shading": True})
    light = Material(diffuse=(1, 1, 1), specular=(0, 0, 0), roughness=1, emissive=(2500.5, 1, 0))
    return Scene(
        name="varied",
        objects=(
            SceneObject(name="a ball/1", mesh=ball, material=random, transform=Transform(scale=(-0.1, 0.2, 0.3))),
            SceneObject(name="ring", mesh=torus, material=gray, transform=Transform(rotation=(12.3, -45, 170))),
            SceneObject(name="a_ball_1", mesh=ball, material=light, transform=Transform(translation=(0, 1 / 3, 2.1))),
        ),
        cameras=(Camera(position=(0.1, -1.7, 0.3), look_at=(0, 0, 0), up=(0.1, 0, 1), fov=37.5),),
    )


def test_saved_scenes_load_the_same(tmp_path: Path) -> None:
    scene = varied_scene()
    again = load_scene(save_scene(scene, tmp_path / "new" / "varied.json"))
    assert (again.name, again.cameras) == (scene.name, scene.cameras)
    before, after = SceneTriangles.from_scene(scene), SceneTriangles.from_scene(again)
    assert after.object_names == before.object_names
    for name in ("positions", "normals", "material", "object_offsets"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), atol=1e-6)


def test_a_material_for_each_face_goes_to_h5_and_not_to_json(tmp_path: Path) -> None:
    scene = varied_scene()
    rows = np.random.default_rng(0).uniform(0, 0.5, (len(scene.objects[1].mesh), 10)).astype(np.float32)
    ring = scene.objects[1].model_copy(update={"face_material": rows})
    scene = Scene(objects=(ring,), cameras=scene.cameras)
    with pytest.raises(SceneError, match=r"varied\.json: object 'ring': .*save it as \.h5"):
        save_scene(scene, tmp_path / "varied.json")
    again = load_scene(save_scene(scene, tmp_path / "varied.h5"))
    np.testing.assert_allclose(SceneTriangles.from_scene(scene).material, rows)
    assert sorted(again.triangles.material[:, 0]) == pytest.approx(sorted(rows[:, 0]), abs=1e-3)


@pytest.mark.parametrize("change", [lambda r: r[1:], lambda r: r - 1, lambda r: r * np.nan, lambda r: r + 1])
def test_a_material_for_each_face_is_checked(change: Callable) -> None:
    item = varied_scene().objects[1]
    rows = np.full((len(item.mesh), 10), 0.5, np.float32)
    with pytest.raises(SceneError, match=r"object: face_material: "):
        SceneObject(name="ring", mesh=item.mesh, material=item.material, face_material=change(rows))


def test_faces_without_area_take_their_material_with_them() -> None:
    mesh = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), np.array([[0, 1, 2], [0, 1, 1], [1, 3, 2]]))
    rows = np.repeat([[0.1], [0.2], [0.3]], 10, axis=1).astype(np.float32)
    gray = Material(diffuse=(0.1,) * 3, specular=(0,) * 3, roughness=1)
    scene = Scene(objects=(SceneObject(name="a", mesh=mesh, material=gray, face_material=rows),))
    np.testing.assert_array_equal(SceneTriangles.from_scene(scene).material[:, 0], rows[[0, 2], 0])


def test_equal_meshes_share_a_file(tmp_path: Path) -> None:
    save_scene(varied_scene(), tmp_path / "varied.json")
    assert sorted(os.listdir(tmp_path / "varied_meshes")) == ["00_a_ball_1.obj", "01_ring.obj"]
    assert sorted(os.listdir(tmp_path)) == ["varied.json", "varied_meshes"]


def test_saving_where_a_file_stands_in_the_way_is_named(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(UserError, match=r"taken.*cannot be written"):
        save_scene(varied_scene(), tmp_path / "taken" / "varied.json")


@pytest.mark.parametrize("name", ["cornell_box", "roughness_spheres", "many_objects_table"])
def test_the_example_scenes_are_like_training_scenes(name: str) -> None:
    scene = load_scene(EXAMPLES / f"{name}.json")
    triangles = SceneTriangles.from_scene(scene)
    assert len(scene.cameras) == 3
    assert len(triangles) < 8192
    solid = triangles.positions[~triangles.is_emissive]
    assert np.abs(solid).max() <= 0.5 + 1e-6
    lights = [item for item in scene.objects if item.material.is_emissive]
    assert 2500 <= sum(item.material.emissive[0] for item in lights) <= 5000
    for item in lights:
        assert len(item.mesh) == 1
        assert 2.1 <= np.linalg.norm(item.transform.translation) <= 2.7
    for camera in scene.cameras:
        assert 1.5 <= np.linalg.norm(np.subtract(camera.position, camera.look_at)) <= 2.0 + 0.2
        assert 30 <= camera.fov <= 60
