"""One reader of OBJ files: the meshes of JSON scenes come from it with the vertices that RenderFormer's tools make."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rfpp.errors import SceneError
from rfpp.scene.io import mesh_files, obj_lines
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.mesh_files import load_material_groups, load_mesh
from rfpp.scene.io.obj_faces import ObjFaces
from rfpp.scene.mesh import Mesh

MESHES = sorted((Path(__file__).parents[3] / "data" / "scenes" / "meshes").glob("*.obj"))
#: A square and a triangle that share vertex 3; vertex 5 is used by no face.
VERTICES = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0.25\nv 9 9 9\nv 1e0 -1.5 +2\n"
ATTRIBUTES = "vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nvn 0 1 0\n"
FACES = {
    "positions": "f 1 2 3\nf 1 3 4\nf 3 2 6\n",
    "texture seams": "f 1/1 2/2 3/3\nf 1/1 3/3 4/2\nf 3/1 2/2 6/1\n",
    "hard edges": "f 1//1 2//1 3//1\nf 1//1 3//1 4//1\nf 3//2 2//2 6//1\n",
    "both": "f 1/1/1 2/2/1 3/3/1\nf 1/1/2 3/3/1 4/1/1\nf 3/2/1 2/2/1 6/1/2\n",
    "here and there": "f 1/1 2/2 3/3\nf 1 3 4\nf 3 2 6\n",
    "materials": "usemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\nusemtl a\nf 3 2 6\n",
    "groups": "o a\ng b\nf 1 2 3\ng c\nf 1 3 4\ns off\nf 3 2 6\n",
    "polygons": "f 1 2 3 4\nf 3 2 6\n",
    "pentagons": "f 1 2 6 3 4\nf 4 3 2 1 6\n",
}


def by_trimesh(path: Path) -> Mesh:
    """As RenderFormer's tools read a mesh."""
    loaded = trimesh.load_mesh(path, process=False, skip_materials=True)
    return Mesh(loaded.vertices, loaded.faces)


def in_order(rows: np.ndarray) -> np.ndarray:
    return rows[np.lexsort(rows.T[::-1])]


@pytest.mark.parametrize("path", MESHES, ids=lambda path: path.stem)
def test_the_repositorys_meshes_are_what_trimesh_makes_of_them(path: Path) -> None:
    ours, theirs = load_mesh(path), by_trimesh(path)
    np.testing.assert_array_equal(ours.vertices, theirs.vertices)
    np.testing.assert_array_equal(ours.faces, theirs.faces)


@pytest.mark.parametrize("faces", FACES.values(), ids=FACES.keys())
def test_so_are_seams_and_materials_whose_vertices_normalisation_counts(faces: str, tmp_path: Path) -> None:
    """The same vertices as often; triangles may come in another order, and begin at another corner."""
    path = tmp_path / "a.obj"
    path.write_text(VERTICES + ATTRIBUTES + faces)
    ours, theirs = load_mesh(path), by_trimesh(path)
    np.testing.assert_array_equal(in_order(ours.vertices), in_order(theirs.vertices))
    triangles = []
    for mesh in (ours, theirs):
        first = np.array([np.lexsort(corners.T[::-1])[0] for corners in mesh.corners])
        turned = np.take_along_axis(mesh.corners, ((first[:, None] + np.arange(3)) % 3)[..., None], axis=1)
        triangles.append(in_order(turned.reshape(-1, 9)))
    np.testing.assert_array_equal(*triangles)


def test_materials_are_meshes_in_the_order_of_the_file_without_what_they_do_not_use(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text("mtllib missing.mtl\n" + VERTICES + FACES["materials"])
    first, second = load_material_groups(path)
    assert [len(first), len(first.vertices), len(second), len(second.vertices)] == [2, 4, 1, 3]


def scene_of(mesh: str, folder: Path) -> Path:
    material = {"diffuse": [0.5] * 3, "specular": [0.0] * 3, "roughness": 0.5, "emissive": [0.0] * 3}
    path = folder / "scene.json"
    objects = {"a": {"mesh_path": mesh, "material": material}}
    path.write_text(json.dumps({"scene_name": "a", "version": "1.0", "objects": objects}))
    return path


def test_meshes_of_json_scenes_are_read_by_the_block_and_by_no_other_library(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "a.obj").write_text(VERTICES + "f 1 2 3\nf 1 3 4\n" * 500)
    monkeypatch.setattr(mesh_files, "trimesh", None)
    monkeypatch.setattr(ObjFaces, "_take_line", None)  # not needed
    monkeypatch.setattr(obj_lines, "LINES", 64)
    (item,) = load_scene(scene_of("a.obj", tmp_path)).objects
    np.testing.assert_array_equal(item.mesh.faces, [[0, 1, 2], [0, 2, 3]] * 500)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (VERTICES + "f 1 2 3\n" * 6, "6 faces are more than 5: decimate it"),
        ("f 1 2 3\n\nf 1 2 7\n" + VERTICES, "line 3: the face refers to vertex 7 of 6: export it again"),
        (VERTICES + "f 1 2 3\n  f 1 2 99 # no\n", "line 8: the face refers to vertex 99 of 6: export it again"),
    ],
)
def test_what_is_wrong_with_them_is_said_with_both_files_names(text, message, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(obj_lines, "MAX_TRIANGLES", 5)
    (tmp_path / "a.obj").write_text(text)
    path = scene_of("a.obj", tmp_path)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert f"{tmp_path / 'a.obj'}: {message}" in str(caught.value)
