"""Limits of faces, lines and pixels, which are checked before anything is parsed or decoded."""

import io
import json
from pathlib import Path

import pytest
from PIL import Image

from rfpp.errors import SceneError
from rfpp.scene.io import image_texture, trimesh_files
from rfpp.scene.io.loading import load_scene

pytestmark = pytest.mark.filterwarnings("ignore")

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def refused(path: Path, text: str, message: str) -> None:
    path.write_text(text)
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("limit", "value", "lines"),
    [
        ("MAX_TRIANGLES", 5, "f 1 2 3\n" * 6),
        ("_MAX_OBJ_NUMBERS", 40, "f" + " 1 2 3" * 20),
        ("_MAX_OTHER_OBJ_LINES", 9, "g a\n" * 10 + "f 1 2 3\n"),
        ("_MAX_OTHER_OBJ_LINES", 9, "\n" * 10 + "f 1 2 3\n"),
        ("_MAX_OBJ_GROUPS", 9, "".join(f"g {number}\n" for number in range(20)) + "f 1 2 3\n"),
    ],
)
def test_obj_files_of_too_many_lines_are_not_parsed(
    limit: str, value: int, lines: str, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(trimesh_files, limit, value)
    monkeypatch.setattr(trimesh_files, "_load", None)
    refused(tmp_path / "a.obj", SQUARE + lines, "a.obj: more than ")


@pytest.mark.parametrize("name", ["a.ply", "a.stl"])
def test_long_texts_are_to_be_saved_as_binary(name: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(trimesh_files, "MAX_TEXT_BYTES", 30)
    header = "ply\nformat ascii 1.0\nelement vertex 4\nend_header\n" if name == "a.ply" else "solid a\n"
    refused(tmp_path / name, header + "0 0 0\n" * 10, "bytes of text.*: save it as binary")


def picture(side: int) -> bytes:
    content = io.BytesIO()
    Image.new("RGB", (side, side)).save(content, "PNG")
    return content.getvalue()


def test_pixels_of_all_textures_are_counted_before_any_is_decoded(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(image_texture, "_MAX_PIXELS_OF_A_FILE", 500)
    monkeypatch.setattr(image_texture, "ImageTexture", None)
    for k in range(6):
        (tmp_path / f"{k}.png").write_bytes(picture(10))
    (tmp_path / "a.mtl").write_text("".join(f"newmtl m{k}\nmap_Kd {k}.png\n" for k in range(6)))
    faces = "".join(f"usemtl m{k}\nf 1/1 2/1 3/1\n" for k in range(6))
    refused(tmp_path / "a.obj", "mtllib a.mtl\nvt 0 0\n" + SQUARE + faces, "its textures have more than 500 pixels")
    document = {
        "asset": {"version": "2.0"},
        "images": [{"uri": f"{k}.png"} for k in range(6)],
        "textures": [{"source": k} for k in range(6)],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": k}}} for k in range(6)],
    }
    refused(tmp_path / "a.gltf", json.dumps(document), "its textures have more than 500 pixels")
