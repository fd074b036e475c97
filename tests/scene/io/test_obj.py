"""OBJ with MTL: groups, materials as Blender means them, and refusals with the line's number."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from rfpp.errors import SceneError
from rfpp.scene.io.imported_scene import ImportedScene
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.mtl import read_mtl
from rfpp.scene.io.obj import read_obj
from rfpp.scene.triangles import DIFFUSE, EMISSION

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
UV = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"


def read(folder: Path, obj: str, mtl: str | None = None) -> ImportedScene:
    if mtl is not None:
        (folder / "my materials.mtl").write_text(mtl)
        obj = f"mtllib my materials.mtl\n{obj}"
    (folder / "scene.obj").write_text(obj)
    return read_obj(folder / "scene.obj")


def row(folder: Path, mtl: str) -> np.ndarray:
    return read(folder, SQUARE + "usemtl it\nf 1 2 3\n", "newmtl it\n" + mtl).parts[0].material[0]


def test_groups_in_each_of_their_materials_are_parts(tmp_path: Path) -> None:
    obj = SQUARE + "o wall\nusemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\ng lid\nf -4 -3 -2 -1\no wall\nusemtl a\nf 1 2 4\n"
    scene = read(tmp_path, obj, "newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 0 1\n")
    assert [(part.name, len(part)) for part in scene.parts] == [("wall a", 2), ("wall b", 1), ("lid b", 2)]
    np.testing.assert_allclose([part.material[0, 0] > 0 for part in scene.parts], [True, False, False])


@pytest.mark.filterwarnings("ignore:.*names no MTL")
def test_without_groups_connected_components_are_parts(tmp_path: Path) -> None:
    scene = read(tmp_path, SQUARE + "v 5 0 0\nv 6 0 0\nv 5 1 0\nf 1 2 3\nf 5 6 7\nf 1 3 4\n")
    assert sorted(map(len, scene.parts)) == [1, 2]


def test_polygons_become_fans_and_comments_nothing(tmp_path: Path) -> None:
    (part,) = read(tmp_path, "# a square\n" + SQUARE + "\no it\nf 1//  2 3 4 # all of it\n", "# none\n").parts
    assert part.areas.sum() == pytest.approx(1)


@pytest.mark.parametrize(
    ("mtl", "expected"),
    [
        ("Kd 0.5 0.5 0.5\nKs 0.5 0.5 0.5\nNs 250\nillum 2\n", [0.48] * 3 + [0.04] * 3 + [0.5]),
        ("Kd 0.5 0.5 0.5\nKs 0.5 0.5 0.5\nNs 1000\nillum 3\n", [0.25] * 3 + [0.5] * 3 + [0]),
        ("Kd 0.5\nKs 0.5 0.5 0.5\nNs 0\nillum 1\n", [0.5] * 3 + [0] * 3 + [1]),
        ("Kd 0.5 0.4 0.3\nPm 1\nPr 0.2\nNs 0\n", [0] * 3 + [0.5, 0.4, 0.3] + [0.2]),
        ("Kd 2 -1 0.5\n", [0.96, 0, 0.48] + [0.04] * 3 + [0.5]),
        ("", [0.768] * 3 + [0.04] * 3 + [0.5]),
    ],
)
def test_materials_are_mapped_as_documented(mtl: str, expected: list, tmp_path: Path) -> None:
    np.testing.assert_allclose(row(tmp_path, mtl)[:7], expected, atol=1e-6)


def test_a_library_is_read_once_and_only_so_many_are(tmp_path: Path, monkeypatch) -> None:
    files = []
    monkeypatch.setattr("rfpp.scene.io.obj.read_mtl", lambda path: files.append(path) or read_mtl(path))
    read(tmp_path, "mtllib my materials.mtl\n" * 3000 + SQUARE + "usemtl it\nf 1 2 3 4\n", "newmtl it\n")
    assert len(files) == 1
    for i in range(101):
        (tmp_path / f"{i}.mtl").write_text("newmtl it\n")
    with pytest.raises(SceneError, match="line 101: more than 100 MTL files"):
        read(tmp_path, "".join(f"mtllib {i}.mtl\n" for i in range(101)))


def test_emission_is_radiance(tmp_path: Path) -> None:
    np.testing.assert_allclose(row(tmp_path, "Ke 10 5 0\n")[EMISSION], [10, 5, 0])


def test_textures_are_averaged_and_their_rows_count_from_below(tmp_path: Path) -> None:
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0] = 255  # the upper half is white
    Image.fromarray(pixels).save(tmp_path / "two tone.png")
    mtl = "newmtl it\nKs 0 0 0\nmap_Kd -s 1 1 1 -clamp on two tone.png\n"
    low = "vt 0 0\nvt 1 0\nvt 1 0.4\nvt 0 0.4\n"
    for coordinates, expected in ((UV.replace(" 0\n", " 0.6\n"), 1), (low, 0)):
        with pytest.warns(UserWarning, match=r"textures are averaged over each triangle \(1\)"):
            scene = read(tmp_path, SQUARE + coordinates + "usemtl it\nf 1/1 2/2 3/3 4/4\n", mtl)
        np.testing.assert_allclose(scene.parts[0].material[:, DIFFUSE], expected, atol=0.01)


@pytest.mark.filterwarnings("ignore:.*names no MTL")
@pytest.mark.parametrize(
    ("obj", "smooth"),
    [
        (SQUARE + "f 1 2 3\n", True),
        (SQUARE + "s off\nf 1 2 3\n", False),
        (SQUARE + "s 1\nf 1 2 3\n", True),
        (SQUARE + "vn 0 0 1\nf 1//1 2//1 3//1\n", False),
        (SQUARE + "vn 0 0.6 0.8\nf 1//1 2//1 3//1\n", True),
    ],
)
def test_normals_or_smoothing_groups_say_whether_a_surface_is_smooth(obj: str, smooth: bool, tmp_path: Path) -> None:
    assert read(tmp_path, obj).parts[0].smooth is smooth


def test_y_is_up_unless_said_otherwise(tmp_path: Path) -> None:
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 4 0 0\nv 0 0 -2\nf 1 2 3\n")
    with pytest.warns(UserWarning, match="names no MTL file: its surfaces are grey"):
        usual = load_scene(tmp_path / "flat.obj")
    np.testing.assert_allclose(np.ptp(usual.objects[0].mesh.vertices, axis=0), [1, 0.5, 0])
    with pytest.warns(UserWarning, match="grey"):
        said = load_scene(tmp_path / "flat.obj", up="z")
    np.testing.assert_allclose(np.ptp(said.objects[0].mesh.vertices, axis=0), [1, 0, 0.5])


@pytest.mark.parametrize("mtl", ["d 0.5\n", "Tr 0.5\n", "illum 4\n", "map_d a.png\n"])
def test_what_is_transparent_becomes_opaque_or_is_left_out_or_refused(mtl: str, tmp_path: Path) -> None:
    (tmp_path / "two.mtl").write_text(f"newmtl pane\nKd 0 1 0\n{mtl}newmtl frame\nKd 1 0 0\n")
    path = tmp_path / "window.obj"
    path.write_text("mtllib two.mtl\n" + SQUARE + "o it\nusemtl pane\nf 1 2 3\nusemtl frame\nf 1 3 4\n")
    lamps = 3  # are added
    with pytest.warns(
        UserWarning,
        match=r"window.obj: material 'pane' \(d, Tr, map_d or illum\): transparent surfaces are not .*opaque",
    ):
        assert len(load_scene(path).objects) == 2 + lamps
    with pytest.warns(UserWarning, match="so it is omitted"):
        names = [item.name for item in load_scene(path, transparent="drop").objects]
    assert len(names) == 1 + lamps and "it frame" in names
    with pytest.raises(
        SceneError, match=r"window.obj: material 'pane' .*: is transparent, .* load it with transparent="
    ):
        load_scene(path, transparent="refuse")


REFUSED = {
    "a missing texture": ("f 1/1 2/2 3/3\n", "map_Kd gone.png\n", "gone.png: cannot be read"),
    "a texture elsewhere": ("f 1 2 3\n", "map_Kd ../x.png\n", "my materials.mtl: line 2: '../x.png' leads out"),
    "a texture on no map": ("f 1 2 3\n", "map_Kd gone.png\n", "map_Kd needs texture coordinates"),
    "words for numbers": ("f 1 2 3\n", "Kd red\n", "my materials.mtl: line 2: 'red' where numbers"),
    "NaN": ("f 1 2 3\n", "Kd nan 0 0\n", "line 2: 'nan 0 0' where 3 finite numbers"),
    "a bad index": ("f 1 2 9\n", "", "line 11: the face refers to vertex 9 of 4"),
    "index zero": ("f 1 2 0\n", "", "line 11: the face refers to vertex 0 of 4"),
    "a bad relative index": ("f 1 2 -9\n", "", "line 11: the face refers to vertex -9 of 4"),
    "a bad coordinate index": ("f 1/9 2/9 3/9\n", "", "a face refers to texture coordinate 9 of 4"),
    "a word": ("v 1 2 x\n", "", r"line 11: 'v 1 2 x' cannot be read"),
    "two numbers": ("v 1 2\n", "", "line 11: 3 numbers were expected"),
    "NaN in a vertex": ("v nan 0 0\nf 5 2 3\n", "", "a vertex is NaN, infinite or too large"),
    "an absurd vertex": ("v 1e300 0 0\nf 5 2 3\n", "", "a vertex is NaN, infinite or too large"),
    "digits": ("f 1 2 " + "9" * 5000 + "\n", "", "line 11: .*cannot be read"),
    "an unknown material": ("usemtl other\nf 1 2 3\n", "", "material 'other' is in none of its MTL files"),
    "no faces": ("", "", "no visible surface"),
    "materials elsewhere": ("mtllib ../x.mtl\n", "", "line 11: '../x.mtl' leads out of the file's folder"),
    "missing materials": ("mtllib gone.mtl\n", "", "line 11: .*gone.mtl: cannot be read"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_represented_or_is_damaged_is_refused_by_name(case: str, tmp_path: Path) -> None:
    obj, mtl, message = REFUSED[case]
    (tmp_path / "my materials.mtl").write_text("newmtl it\n" + mtl)
    (tmp_path / "scene.obj").write_text("mtllib my materials.mtl\n" + SQUARE + UV + "usemtl it\n" + obj)
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(tmp_path / "scene.obj")
    assert str(caught.value).startswith(f"{tmp_path / 'scene.obj'}: ")
    assert "\n" not in str(caught.value)
