"""Lines that are read together mean what they mean one by one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rfpp.errors import SceneError
from rfpp.scene.io.obj import read_obj
from rfpp.scene.io.obj_lines import Block, blocks

pytestmark = pytest.mark.filterwarnings("ignore:.*MTL file")


def _text(notation: str, faces: int = 40) -> str:
    """A strip of triangles."""
    vertices = [f"v {i % 7}.25 {i * 0.5e-1:.4e} -{i}" for i in range(faces + 2)]
    others = [line for i in range(faces + 2) for line in (f"vt 0.{i} 1", f"vn 0 {i + 1} 1 ")]
    corners = (" ".join(notation.format(i + j) for j in range(1, 4)) for i in range(faces))
    return "\n".join([*vertices, *sorted(others), *(f"f {c}" for c in corners)])


def _read(text: str, folder: Path) -> tuple[np.ndarray, bool] | str:
    file = folder / "a.obj"
    file.write_text(text)
    try:
        parts = read_obj(file).parts
    except SceneError as error:
        return str(error)
    return np.concatenate([part.vertices[part.faces] for part in parts]), parts[0].smooth


def _one_by_one(text: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[np.ndarray, bool] | str:
    with monkeypatch.context() as patch:
        patch.setattr(Block, "polygons", lambda block, counts: None)
        return _read(text, folder)


def _require_equal(text: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    together, single = _read(text, folder), _one_by_one(text, folder, monkeypatch)
    if isinstance(single, str):
        assert together == single
    else:
        np.testing.assert_array_equal(together[0], single[0])
        assert together[1] == single[1]


@pytest.mark.parametrize("notation", ["{0}", "{0}/{0}", "{0}//{0}", "{0}/{0}/{0}", "-{0}", "-{0}//-{0}"])
def test_all_notations_are_read_alike(notation: str, tmp_path: Path, monkeypatch) -> None:
    text = _text(notation)
    _require_equal(text, tmp_path, monkeypatch)
    (block,) = blocks(text.encode())
    sizes, corners = block.polygons([0, 0, 0])  # not left to the reader of single lines
    assert sizes.tolist() == [3] * 40
    assert corners.shape == (120, 3)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("f 5 6 7", "f 5 6 7 8"),
        ("f 5 6 7", "f 5 6 7 # a comment"),
        ("f 5 6 7", "f 5/5 6 7"),
        ("f 5 6 7", "f 5 6"),
        ("f 5 6 7", "f"),
        ("f 5 6 7", "\tf 5  6\t7\r"),
        ("f 5 6 7", "f 5 6 \\"),
        ("f 5 6 7", "\n\nf 5 6 7\ns off"),
        ("f 5 6 7", "f 5 0 7"),
        ("f 5 6 7", "f 5 99 7"),
        ("f 5 6 7", "f 5 6 7e0"),
        ("f 5 6 7", "f 5 6 7.0"),
        ("f 5 6 7", "f 5 6 99999999999999999999999"),
        ("f 5 6 7", "f 5 -60 7"),
        ("f 5 6 7", "f 5 6- 7"),
        ("v 3.25", "v 3.25 1"),
        ("v 3.25", "v nan"),
        ("v 3.25", "v 1-2"),
        ("v 3.25", "v 3/2"),
        ("v 3.25", "v 3v25"),
        ("v 3.25", "v"),
        ("v 3.25", "v\x0b3.25"),
        ("v 3.25", "vp 3.25"),
    ],
)
def test_what_is_unusual_is_read_or_refused_as_line_by_line(old: str, new: str, tmp_path: Path, monkeypatch) -> None:
    text = _text("{0}")
    assert old in text
    _require_equal(text.replace(old, new, 1), tmp_path, monkeypatch)


@given(
    st.lists(st.sampled_from(["v 1 2 3", "f 1 2 3", "v 1", "vn 1 1 1", "", " ", "o a", "vt", "#", "f"]), max_size=30)
)
def test_blocks_and_their_pieces_are_all_lines_in_order(lines: list[str]) -> None:
    text = "\n".join([*lines, "f 1 1 1"]).encode()
    pieces = [piece for block in blocks(text) for piece in block.pieces(4)]
    assert b"".join(piece.line(number) for piece in pieces for number in range(len(piece))) == text
    assert [piece.first for piece in pieces] == list(np.cumsum([1, *map(len, pieces)])[:-1])


def test_a_file_of_many_faces_is_read_in_pieces(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("rfpp.scene.io.obj_lines.LINES", 7)
    _require_equal(_text("{0}/{0}/{0}"), tmp_path, monkeypatch)
    _require_equal(_text("-{0}"), tmp_path, monkeypatch)
