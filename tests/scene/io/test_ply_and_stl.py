"""PLY and STL: components, colours, both endians and text; and counts that are not believed."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rfpp.errors import SceneError
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.mesh_files import load_mesh
from rfpp.scene.io.ply import read_ply
from rfpp.scene.io.stl import read_stl
from rfpp.scene.triangles import DIFFUSE

VERTICES = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)]
POLYGONS = [(0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
HEADER = """ply
format {} 1.0
comment made by hand
element vertex 5
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 5
property list uchar int vertex_indices
property uchar quality
end_header
"""


def pyramid(form: str) -> bytes:
    """A square and four triangles: rows of two lengths."""
    if form == "ascii":
        rows = [f"{x} {y} {z} 255 0 {i}" for i, (x, y, z) in enumerate(VERTICES)]
        rows += [" ".join(map(str, (len(p), *p, 7))) for p in POLYGONS]
        return (HEADER.format(form) + "\n".join(rows) + "\n").encode()
    order = "<" if "little" in form else ">"
    vertices = b"".join(struct.pack(f"{order}3f3B", *v, 255, 0, i) for i, v in enumerate(VERTICES))
    faces = b"".join(struct.pack(f"{order}B{len(p)}iB", len(p), *p, 7) for p in POLYGONS)
    return HEADER.format(form).encode() + vertices + faces


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_polygons_of_different_sizes_are_read_from_every_kind_of_ply(form: str, tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(pyramid(form))
    (part,) = read_ply(tmp_path / "a.ply").parts
    assert len(part) == 6
    solid = trimesh.Trimesh(part.vertices, part.faces, process=False)
    assert solid.volume == pytest.approx(1 / 3)  # closed, and facing outwards
    np.testing.assert_allclose(part.material[:, 0], 0.96)  # red is 255
    np.testing.assert_allclose(part.material[:, 1], 0)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_components_are_parts_and_colours_of_faces_their_albedo(encoding: str, tmp_path: Path) -> None:
    ball, box = trimesh.creation.icosphere(2), trimesh.creation.box().apply_translation([3, 0, 0])
    ball.visual.face_colors = [188, 0, 0, 255]  # half of full brightness
    box.visual.face_colors = [0, 255, 0, 255]
    both = trimesh.util.concatenate([ball, box])
    both.export(tmp_path / "two.ply", encoding=encoding)
    parts = read_ply(tmp_path / "two.ply").parts
    assert [len(part) for part in parts] == [320, 12]
    np.testing.assert_allclose(parts[0].material[:, DIFFUSE], np.tile([0.5 * 0.96, 0, 0], (320, 1)), atol=0.005)
    np.testing.assert_allclose(parts[1].material[:, DIFFUSE], np.tile([0, 0.96, 0], (12, 1)))


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_stl_of_both_kinds(kind: str, tmp_path: Path) -> None:
    solids = [trimesh.creation.box().apply_translation([3 * i, 0, 0]) for i in range(3)]
    trimesh.util.concatenate(solids).export(tmp_path / "boxes.stl", file_type=kind)
    parts = read_stl(tmp_path / "boxes.stl").parts
    assert [len(part) for part in parts] == [12, 12, 12]
    for index, part in enumerate(parts):
        np.testing.assert_allclose(part.corners.mean(axis=(0, 1)), [3 * index, 0, 0], atol=1e-6)


def test_a_binary_stl_may_call_itself_solid(tmp_path: Path) -> None:
    content = trimesh.creation.box().export(file_type="stl")
    (tmp_path / "box.stl").write_bytes(b"solid" + content[5:])
    assert len(read_stl(tmp_path / "box.stl").parts[0]) == 12


def claiming(count: int, name: str = "face") -> bytes:
    return pyramid("binary_little_endian").replace(f"element {name} 5".encode(), f"element {name} {count}".encode())


STL = trimesh.creation.box().export(file_type="stl")
REFUSED = {
    "absurd.ply": (claiming(10**9), "claims 1,000,000,000 of 'face', more than it holds"),
    "absurd_vertices.ply": (claiming(10**18, "vertex"), "claims 1,000,000,000,000,000,000 of 'vertex'"),
    "negative.ply": (claiming(-1), "claims -1 of 'face'"),
    "text.ply": (pyramid("ascii").replace(b"face 5", b"face 900000000"), "claims 900,000,000 of 'face'"),
    "cut.ply": (pyramid("binary_little_endian")[:-5], "ends within 'face'"),
    "cut_text.ply": (pyramid("ascii")[:-12], "a row of 'face' is damaged"),
    "long_list.ply": (pyramid("binary_little_endian").replace(b"uchar int", b"uint int"), "ends within 'face'|damaged"),
    "long_text.ply": (pyramid("ascii").replace(b"4 0 3 2 1", b"999999999999999999999"), "a row of 'face' is damaged"),
    "no_header.ply": (b"ply\nformat ascii 1.0\n", "not a PLY file with a whole header"),
    "type.ply": (pyramid("ascii").replace(b"float x", b"string x"), "its header says 'property string x'"),
    "length.ply": (
        pyramid("ascii").replace(b"list uchar", b"list float"),
        "its header says 'property list float",
    ),
    "format.ply": (pyramid("ascii").replace(b"ascii", b"gzip"), "its header says 'format gzip 1.0'"),
    "empty_rows.ply": (
        b"ply\nformat binary_little_endian 1.0\nelement face 999999999\nend_header\n", "claims 999,999,999 of 'face'"
    ),
    "points.ply": (pyramid("ascii").replace(b"vertex_indices", b"something"), "holds no faces, and points cannot"),
    "index.ply": (pyramid("ascii").replace(b"3 0 1 4", b"3 0 1 9"), "a face refers to none of 5 vertices"),
    "nan.ply": (pyramid("ascii").replace(b"0.5 0.5 1", b"0.5 nan 1"), "a vertex is NaN"),
    "empty.ply": (b"", "is empty"),
    "absurd.stl": (STL[:80] + struct.pack("<I", 10**9) + STL[84:], "claims 1,000,000,000 triangles and 600 bytes"),
    "cut.stl": (STL[:-1], "claims 12 triangles and 599 bytes follow"),
    "nothing.stl": (b"solid\nendsolid\n", "holds no triangles"),
    "word.stl": (b"solid\nvertex 0 0 zero\n", "line 2: 'vertex 0 0 zero' is no vertex"),
    "cut_text.stl": (b"solid\nvertex 0 0 0\n", "ends within a triangle"),
    "inf.stl": (b"solid\n" + b"vertex 0 0 0\nvertex 1 0 0\nvertex 0 inf 0\n", "a vertex is NaN, infinite or too large"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_file_claims_is_checked_before_it_is_believed(name: str, tmp_path: Path) -> None:
    content, message = REFUSED[name]
    (tmp_path / name).write_bytes(content)
    tracemalloc.start()
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(tmp_path / name)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    assert str(caught.value).startswith(f"{tmp_path / name}: ")


@pytest.mark.parametrize("name", ["absurd.ply", "absurd_vertices.ply", "absurd.stl", "empty.ply"])
def test_meshes_of_scenes_are_not_believed_either(name: str, tmp_path: Path) -> None:
    content, message = REFUSED[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SceneError, match=message):
        load_mesh(tmp_path / name)
