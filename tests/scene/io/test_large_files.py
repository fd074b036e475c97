"""Files of very many lines, rows and pixels: read together where they are regular, else refused by their number."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from rfpp.errors import SceneError
from rfpp.scene.io import image_texture, number_lines, obj_faces, obj_lines, ply_file, stl
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.obj import read_obj
from rfpp.scene.io.ply import read_ply
from rfpp.scene.io.stl import read_stl

pytestmark = pytest.mark.filterwarnings("ignore")

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
PLY = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
CORNERS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"


def refused(path: Path, text: str, message: str) -> None:
    path.write_text(text)
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_an_obj_file_of_too_many_lines_of_a_kind_is_refused_by_their_number(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(obj_lines, "MAX_TRIANGLES", 5)
    monkeypatch.setattr(obj_lines, "MAX_SINGLE_LINES", 9)
    path = tmp_path / "a.obj"
    refused(path, SQUARE + "f 1 2 3\n" * 6, "6 faces are more than 5: decimate it")
    refused(path, SQUARE * 4 + "f 1 2 3\n", "16 vertices, .* are more than 15: decimate it")
    for other in ("g a\n", "usemtl a\n", " \n", "s 1\n"):
        refused(path, SQUARE + other * 10 + "f 1 2 3\n", "10 lines of groups, .* are more than 9: join its groups")
    path.write_text("# \n" * 20 + "\n" * 20 + SQUARE + "g a\n" * 9 + "f 1 2 3\n" * 5)
    assert len(read_obj(path).parts[0]) == 5


def test_only_so_many_unusual_lines_are_read_one_by_one(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(obj_faces, "MAX_SINGLE_LINES", 20)
    for module in (obj_faces, ply_file, stl):
        monkeypatch.setattr(module, "MAX_SINGLE_LINES", 20)
    refused(tmp_path / "a.obj", SQUARE + "f 1 2 3 # one\n" * 17, "more than 20 of its lines are written unusually")
    faces = "element face 21\nproperty list uchar int a\nproperty list uchar int vertex_indices\nend_header\n"
    refused(
        tmp_path / "a.ply", PLY + faces + CORNERS + "0 3 0 1 2\n" * 21, "more than 20 rows .*: save it as binary PLY"
    )
    vertices = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 inf\n" * 7
    refused(tmp_path / "a.stl", "solid a\n" + vertices, "more than 20 .* unusually: save it as binary STL")


def test_an_unusual_line_leaves_the_rest_of_its_block_to_the_fast_reader(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(obj_faces, "FEW_LINES", 4)
    monkeypatch.setattr(obj_faces, "MAX_SINGLE_LINES", 4)
    path = tmp_path / "a.obj"
    path.write_text(SQUARE + "f 1 2 3\n" * 50 + "f 1 2 4 # odd\n" + "f 2 3 4\n" * 50)
    faces = read_obj(path).parts[0].faces
    np.testing.assert_array_equal(faces, [[0, 1, 2]] * 50 + [[0, 1, 3]] + [[1, 2, 3]] * 50)


def test_faces_between_groups_belong_to_theirs_and_count_back_from_where_they_stand(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    rows = [f"v 0 0 {k}\nv 1 0 {k}\nv 0 1 {k}\ng part_{k % 3}\nf -3 -2 -1\n" for k in range(60)]
    path.write_text("".join(rows))
    parts = read_obj(path).parts
    assert [part.name for part in parts] == ["part_0", "part_1", "part_2"]
    for number, part in enumerate(parts):
        np.testing.assert_array_equal(part.corners[:, :, 2], np.repeat(np.arange(number, 60, 3)[:, None], 3, axis=1))


@pytest.mark.parametrize("rows", ["3 0 1 2\n", "3 0 1 2\n4 0 1 2 3\n", "  3 0 1 2 \r\n3\t0 2 3\n"])
def test_text_ply_is_read_together_as_row_by_row(rows: str, tmp_path: Path, monkeypatch) -> None:
    count = 40 * len(rows.splitlines())
    path = tmp_path / "a.ply"
    path.write_text(
        PLY + f"element face {count}\nproperty list uchar int vertex_indices\nend_header\n{CORNERS}{rows * 40}"
    )
    monkeypatch.setattr(ply_file, "LINES", 7)
    with monkeypatch.context() as patch:
        patch.setattr(ply_file, "_rows", lambda *_: None)
        single = read_ply(path).parts
    monkeypatch.setattr(ply_file, "_rows_one_by_one", None)  # not needed
    for part, other in zip(read_ply(path).parts, single, strict=True):
        np.testing.assert_array_equal(part.corners, other.corners)


def test_text_stl_is_read_together_as_line_by_line(tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "a.stl"
    facet = "  facet\n\n outer loop\n\tvertex 0 0 {0}\nvertex 1 0 {0}\r\n vertex  0 1e0 {0}\nendloop\nendfacet\n"
    path.write_text("solid vertex\n" + "".join(facet.format(k) for k in range(30)) + "endsolid vertex")
    monkeypatch.setattr(stl, "LINES", 11)
    with monkeypatch.context() as patch:
        patch.setattr(stl, "_vertices", lambda *_: None)
        single = read_stl(path).parts
    monkeypatch.setattr(stl, "_vertices_one_by_one", None)  # not needed
    parts = read_stl(path).parts
    assert len(parts) == 30
    for part, other in zip(parts, single, strict=True):
        np.testing.assert_array_equal(part.corners, other.corners)


def test_lines_of_absurd_length_are_refused_wherever_they_stand(monkeypatch) -> None:
    monkeypatch.setattr(number_lines, "MAX_LINE_BYTES", 10)
    for text in (b"1 2 3\n" + b"4" * 11, b"4" * 11 + b"\n1\n"):
        with pytest.raises(SceneError, match="a line has 1[12] bytes"):
            number_lines.line_bounds(number_lines.characters(text))
    assert number_lines.line_bounds(number_lines.characters(b"1\n22\n3"), 2).tolist() == [2, 5, 6]


def picture(side: int) -> bytes:
    content = io.BytesIO()
    Image.new("RGB", (side, side)).save(content, "PNG")
    return content.getvalue()


def test_pixels_of_all_textures_are_counted_before_any_is_decoded(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(image_texture, "_MAX_PIXELS_OF_A_FILE", 500)
    monkeypatch.setattr(image_texture, "ImageTexture", None)  # none is made
    for k in range(6):
        (tmp_path / f"{k}.png").write_bytes(picture(10))
    (tmp_path / "a.mtl").write_text("".join(f"newmtl m{k}\nmap_Kd {k}.png\n" for k in range(6)))
    faces = "".join(f"usemtl m{k}\nf 1/1 2/1 3/1\n" for k in range(6))
    refused(tmp_path / "a.obj", "mtllib a.mtl\nvt 0 0\n" + SQUARE + faces, "its textures have more than 500 pixels")


def test_so_are_those_of_gltf(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(image_texture, "_MAX_PIXELS_OF_A_FILE", 500)
    monkeypatch.setattr(image_texture, "ImageTexture", None)
    for k in range(6):
        (tmp_path / f"{k}.png").write_bytes(picture(10))
    document = {
        "asset": {"version": "2.0"},
        "images": [{"uri": f"{k}.png"} for k in range(6)],
        "textures": [{"source": k} for k in range(6)],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": k}}} for k in range(6)],
    }
    refused(tmp_path / "a.gltf", json.dumps(document), "its textures have more than 500 pixels")
