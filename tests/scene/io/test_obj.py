"""OBJ with MTL: groups, materials as Blender writes them, and refusals that name the line."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from rfpp.errors import SceneError
from rfpp.scene.io import trimesh_files
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.mesh_files import load_mesh
from rfpp.scene.mesh import Mesh
from rfpp.scene.spec import SceneObject

pytestmark = pytest.mark.filterwarnings("ignore:.*(scaled by|no camera|no light|names no MTL|transparent surfaces)")

MESHES = sorted((Path(__file__).parents[3] / "data" / "scenes" / "meshes").glob("*.obj"))
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
UV = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"


def surfaces(folder: Path, obj: str, mtl: str | None = None, **options) -> list[SceneObject]:
    """Objects of a file, without the lights that are added."""
    if mtl is not None:
        (folder / "my materials.mtl").write_text(mtl)
        obj = f"mtllib my materials.mtl\n{obj}"
    (folder / "scene.obj").write_text(obj)
    objects = load_scene(folder / "scene.obj", backdrop="none", **options).objects
    return [item for item in objects if not item.name.endswith("_light")]


def test_groups_in_each_of_their_materials_are_objects(tmp_path: Path) -> None:
    obj = SQUARE + "o wall\nusemtl röt\nf 1 2 3\nusemtl b  b\nf 1 3 4\ng lid\nf 4 3 2 1\no wall\nusemtl röt\nf 1 2 4\n"
    objects = surfaces(tmp_path, obj, "newmtl röt\nKd 1 0 0\nnewmtl b b\nKd 0 0 1\n")
    assert [(item.name, len(item.mesh)) for item in objects] == [("wall röt", 2), ("wall b b", 1), ("lid b b", 2)]
    assert [item.material.diffuse[0] > 0 for item in objects] == [True, False, False]


@pytest.mark.parametrize("faces", ["f 1 2 3 4\ng b\nf  5 4 3 # back\n", "f 1 2 3\nvn 0 1 0\ng b\nf 2 3 4 5\nf 1 3 5\n"])
def test_many_groups_of_many_vertices_are_read_the_same(faces: str, tmp_path: Path, monkeypatch) -> None:
    """They get normals while they are read, which must not reach the meshes."""
    text = f"{SQUARE}v 1 1 1\ng a\n{faces}"
    expected = surfaces(tmp_path, text)
    monkeypatch.setattr(trimesh_files, "_MANY_OBJ_VISITS", 1)
    for item, other in zip(surfaces(tmp_path, text), expected, strict=True):
        assert (item.name, item.material) == (other.name, other.material)
        np.testing.assert_array_equal(item.mesh.corners, other.mesh.corners)


def test_without_groups_connected_components_are_objects(tmp_path: Path) -> None:
    objects = surfaces(tmp_path, SQUARE + "v 5 0 0\nv 6 0 0\nv 5 1 0\nf 1 2 3\nf 5 6 7\nf 1 3 4\n")
    assert sorted(len(item.mesh) for item in objects) == [1, 2]


@pytest.mark.parametrize("face", ["1 2 3 4", "1// 2// 3// 4//", "1/1 2/2 3/3 4/4", "1//1 2//1 3//1 4//1"])
def test_polygons_tabs_comments_and_continued_lines(face: str, tmp_path: Path) -> None:
    text = f"# a square\n{SQUARE}{UV}vn 0 0 1\n\no it\nl 1 2\n\tf\t{face} # all of it\r\nf 1 \\\n2 3 4 2\nf 1 2 3\n"
    (item,) = surfaces(tmp_path, text.replace("v 1 1 0", " v 1e0 +1. 0 1"))
    assert len(item.mesh) == 2 + 3 + 1
    areas = trimesh.Trimesh(item.mesh.vertices, item.mesh.faces, process=False).area_faces
    np.testing.assert_allclose(areas[:2], 0.5)


@pytest.mark.parametrize(
    ("mtl", "expected"),
    [
        ("Kd 0.5 0.5 0.5\nKs 0.5 0.5 0.5\nNs 250\nillum 2\n", [0.48] * 3 + [0.04] * 3 + [0.5]),
        ("Kd 0.5 0.5 0.5\nKs 0.5 0.5 0.5\nNs 1000\nillum 3\n", [0.25] * 3 + [0.5] * 3 + [0]),
        ("Kd 0.5\nKs 0.5 0.5 0.5\nNs 0\nillum 1\n", [0.5] * 3 + [0] * 3 + [1]),
        ("Kd 0.5 0.4 0.3\nPm 1\nPr 0.2\nNs 0\n", [0] * 3 + [0.5, 0.4, 0.3] + [0.2]),
        ("\tKd 2 -1 0.5\n", [0.96, 0, 0.48] + [0.04] * 3 + [0.5]),
        ("", [0.768] * 3 + [0.04] * 3 + [0.5]),
    ],
)
def test_materials_are_mapped_as_documented(mtl: str, expected: list, tmp_path: Path) -> None:
    (item,) = surfaces(tmp_path, SQUARE + "usemtl it\nf 1 2 3\n", f"newmtl it\n{mtl}")
    material = item.material
    np.testing.assert_allclose([*material.diffuse, *material.specular, material.roughness], expected, atol=1e-6)


def test_emission_is_radiance(tmp_path: Path) -> None:
    obj = SQUARE + "usemtl it\nf 1 2 3\nusemtl other\nf 1 3 4\n"
    objects = surfaces(tmp_path, obj, "newmtl it\nKe 10 5 0\nnewmtl other\n")
    assert {item.name: item.material.emissive for item in objects} == {"it": (10, 5, 0), "other": (0, 0, 0)}


def test_textures_are_averaged_and_their_rows_count_from_below(tmp_path: Path) -> None:
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0] = 255  # the upper half is white
    Image.fromarray(pixels).save(tmp_path / "two tone.png")
    mtl = "newmtl it\nKs 0 0 0\nmap_Kd -s 1 1 1 -clamp on two tone.png\n"
    low = "vt 0 0\nvt 1 0\nvt 1 0.4\nvt 0 0.4\n"
    for coordinates, expected in ((UV.replace(" 0\n", " 0.6\n"), 1), (low, 0)):
        with pytest.warns(UserWarning, match=r"textures \(1\) are seen as they are; .* per triangle$"):
            (item,) = surfaces(tmp_path, SQUARE + coordinates + "usemtl it\nf 1/1 2/2 3/3 4/4\n", mtl)
        np.testing.assert_allclose(item.material.diffuse, expected, atol=0.01)


@pytest.mark.parametrize(
    ("obj", "smooth"),
    [
        (SQUARE + "f 1 2 3\n", True),
        (SQUARE + "vn 0 0 1\nf 1//1 2//1 3//1\n", False),
        (SQUARE + "vn 0 0.6 0.8\nf 1//1 2//1 3//1\n", True),
    ],
)
def test_stored_normals_mark_flat_surfaces(obj: str, smooth: bool, tmp_path: Path) -> None:
    (item,) = surfaces(tmp_path, obj)
    assert item.material.smooth_shading is smooth


def test_y_is_up_unless_overridden(tmp_path: Path) -> None:
    flat = "v 0 0 0\nv 4 0 0\nv 0 0 -2\nf 1 2 3\n"
    with pytest.warns(UserWarning, match="names no MTL file: its surfaces are gray"):
        (usual,) = surfaces(tmp_path, flat)
    np.testing.assert_allclose(np.ptp(usual.mesh.vertices, axis=0), [1, 0.5, 0])
    (z_up,) = surfaces(tmp_path, flat, up="z")
    np.testing.assert_allclose(np.ptp(z_up.mesh.vertices, axis=0), [1, 0, 0.5])


@pytest.mark.parametrize("mtl", ["d 0.5\n", "Tr 0.5\n", "illum 4\n", "map_d a.png\n"])
def test_transparent_surfaces_become_opaque_or_are_dropped_or_refused(mtl: str, tmp_path: Path) -> None:
    materials = f"newmtl pane\nKd 0 1 0\n{mtl}newmtl frame\nKd 1 0 0\n"
    window = SQUARE + "o it\nusemtl pane\nf 1 2 3\nusemtl frame\nf 1 3 4\n"
    why = r"scene.obj: material 'pane' \(d, Tr, map_d or illum\): "
    with pytest.warns(UserWarning, match=why + "transparent surfaces are not .*opaque"):
        assert len(surfaces(tmp_path, window, materials)) == 2
    with pytest.warns(UserWarning, match="so it is omitted"):
        (frame,) = surfaces(tmp_path, window, materials, transparent="drop")
    assert frame.name == "it frame"
    with pytest.raises(SceneError, match=why + "is transparent, .* load it with transparent="):
        surfaces(tmp_path, window, materials, transparent="refuse")


REFUSED = {
    "a missing texture": ("f 1/1 2/2 3/3\n", "map_Kd gone.png\n", "material 'it': .*gone.png: cannot be read"),
    "a texture elsewhere": ("f 1 2 3\n", "map_Kd ../x.png\n", "my materials.mtl: line 2: '../x.png' leads out"),
    "a texture that is a device": ("f 1/1 2/2 3/3\n", "map_Kd zero.png\n", "zero.png: is not a regular file"),
    "a texture on no map": ("f 1 2 3\n", "map_Kd gone.png\n", "map_Kd needs texture coordinates"),
    "words for numbers": ("f 1 2 3\n", "Kd red\n", "my materials.mtl: line 2: 'red' where 3 finite numbers"),
    "NaN": ("f 1 2 3\n", "Kd nan 0 0\n", "line 2: 'nan 0 0' where 3 finite numbers"),
    "a bad index": ("f 1 2 9\n", "", "cannot be read .index 8 is out of bounds"),
    "index zero": ("f 1 2 0\n", "", "'f 1 2 0' cannot be read: export it again, with positive indices"),
    "a negative index": ("f 1 2 -1\n", "", "'f 1 2 -1' cannot be read: export it again, with positive indices"),
    "two notations": ("f 1/1 2/2 3\n", "", "'f 1/1 2/2 3' cannot be read"),
    "a fraction": ("f 1 2 3.0\n", "", "'f 1 2 3.0' cannot be read"),
    "a word": ("v 1 2 x\nf 1 2 3\n", "", "'v 1 2 x' cannot be read"),
    "two numbers": ("v 1 2\nf 1 2 3\n", "", "'v 1 2' cannot be read"),
    "NaN in a vertex": ("v nan 0 0\nf 5 2 3\n", "", "'v nan 0 0' cannot be read"),
    "an absurd vertex": ("v 1e300 0 0\nf 5 2 3\n", "", "a vertex is NaN, infinite or too large"),
    "digits": ("f 1 2 " + "9" * 5000 + "\n", "", "cannot be read"),
    "an unknown material": ("usemtl other\nf 1 2 3\n", "", "material 'other' is in none of its MTL files"),
    "no faces": ("", "", "the mesh has no faces"),
    "materials elsewhere": ("mtllib ../x.mtl\nf 1 2 3\n", "", "'../x.mtl' leads out of the file's folder"),
    "missing materials": ("mtllib gone.mtl\nf 1 2 3\n", "", "gone.mtl: cannot be read"),
    "many libraries": ("".join(f"mtllib ./{'./' * i}my materials.mtl\n" for i in range(101)) + "f 1 2 3\n", "",
                       "more than 100 MTL files"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_damaged_files_are_refused_in_one_line(case: str, tmp_path: Path) -> None:
    obj, mtl, message = REFUSED[case]
    (tmp_path / "zero.png").symlink_to("/dev/zero")
    with pytest.raises(SceneError, match=message) as caught:
        surfaces(tmp_path, SQUARE + UV + "usemtl it\n" + obj, "newmtl it\n" + mtl)
    assert str(caught.value).startswith(f"{tmp_path / 'scene.obj'}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("path", MESHES, ids=lambda path: path.stem)
def test_meshes_of_json_scenes_have_the_vertices_of_renderformers_tools(path: Path) -> None:
    loaded = trimesh.load_mesh(path, process=False, skip_materials=True)
    ours, theirs = load_mesh(path), Mesh(loaded.vertices, loaded.faces)
    np.testing.assert_array_equal(ours.vertices, theirs.vertices)
    np.testing.assert_array_equal(ours.faces, theirs.faces)
