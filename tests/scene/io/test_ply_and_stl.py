"""PLY and STL: components, colors, binary and text; and counts that are checked against the file."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rfpp.errors import SceneError
from rfpp.scene.io.loading import load_scene
from rfpp.scene.spec import SceneObject
from rfpp.scene.triangles import DIFFUSE

pytestmark = pytest.mark.filterwarnings("ignore:.*(scaled by|no camera|no light)")

VERTICES = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1)]
FACES = [(0, 3, 2), (0, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
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
element face {}
property list uchar int vertex_indices
property uchar quality
end_header
"""


def pyramid(form: str, faces: list = FACES) -> bytes:
    header = HEADER.format(form, len(faces)).encode()
    if form == "ascii":
        rows = [f"{x} {y} {z} 255 0 {i}" for i, (x, y, z) in enumerate(VERTICES)]
        rows += [" ".join(map(str, (len(face), *face, 7))) for face in faces]
        return header + ("\n".join(rows) + "\n").encode()
    order = "<" if "little" in form else ">"
    vertices = b"".join(struct.pack(f"{order}3f3B", *v, 255, 0, i) for i, v in enumerate(VERTICES))
    return header + vertices + b"".join(struct.pack(f"{order}B{len(f)}iB", len(f), *f, 7) for f in faces)


def surfaces(folder: Path, name: str, content: bytes | str) -> list[SceneObject]:
    """Objects of a file, without the lights that are added."""
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    objects = load_scene(folder / name, backdrop="none").objects
    return [item for item in objects if not item.name.endswith("_light")]


MIXED = [(0, 3, 2, 1), *FACES[2:]]
QUADS = [(0, 3, 2, 1), (0, 1, 4, 4), (1, 2, 4, 4), (2, 3, 4, 4), (3, 0, 4, 4)]


@pytest.mark.parametrize(
    ("form", "faces", "count"),
    [
        ("ascii", FACES, 6),
        ("binary_little_endian", FACES, 6),
        ("binary_big_endian", FACES, 6),
        ("ascii", MIXED, 6),
        ("binary_little_endian", QUADS, 10),
    ],
)
def test_every_kind_of_ply(form: str, faces: list, count: int, tmp_path: Path) -> None:
    (item,) = surfaces(tmp_path, "a.ply", pyramid(form, faces))
    assert len(item.mesh) == count
    solid = trimesh.Trimesh(item.mesh.vertices, item.mesh.faces, process=False)
    assert solid.volume == pytest.approx(1 / 3)  # closed, and facing outwards
    np.testing.assert_allclose(item.material.diffuse[:2], [0.96, 0], atol=1e-6)  # red is 255


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_components_are_objects_and_colors_of_faces_their_albedo(encoding: str, tmp_path: Path) -> None:
    ball, box = trimesh.creation.icosphere(2), trimesh.creation.box().apply_translation([3, 0, 0])
    ball.visual.face_colors = [188, 0, 0, 255]  # half of full brightness
    box.visual.face_colors = [0, 255, 0, 255]
    both = trimesh.util.concatenate([ball, box])
    first, second = surfaces(tmp_path, "two.ply", both.export(file_type="ply", encoding=encoding))
    assert [len(first.mesh), len(second.mesh)] == [320, 12]
    np.testing.assert_allclose(first.material.diffuse, [0.5 * 0.96, 0, 0], atol=0.005)
    np.testing.assert_allclose(second.material.diffuse, [0, 0.96, 0], atol=1e-6)


def test_colors_of_vertices_survive_texture_coordinates(tmp_path: Path) -> None:
    text = (
        pyramid("ascii")
        .decode()
        .replace("property uchar red", "property float s\nproperty float t\nproperty uchar red")
    )
    for number, (x, y, z) in enumerate(VERTICES):
        text = text.replace(f"{x} {y} {z} 255 0 {number}\n", f"{x} {y} {z} {0.1 * number} 0 {50 * number} 0 0\n")
    (item,) = surfaces(tmp_path, "a.ply", text)
    red = item.face_material[:, DIFFUSE][:, 0]
    assert red.argmax() == 4 and red.argmin() == 1


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_stl_of_both_kinds(kind: str, tmp_path: Path) -> None:
    solids = [trimesh.creation.box().apply_translation([3 * i, 0, 0]) for i in range(3)]
    content = trimesh.util.concatenate(solids).export(file_type=kind)
    objects = surfaces(tmp_path, "boxes.stl", b"solid" + content[5:] if kind == "stl" else content)  # as some write it
    assert [len(item.mesh) for item in objects] == [12, 12, 12]
    np.testing.assert_allclose([item.transform.translation[0] for item in objects], [-3 / 7, 0, 3 / 7], atol=1e-6)


def test_a_text_stl_of_several_solids(tmp_path: Path) -> None:
    facet = "\tFacet\n\n outer loop\n\tvertex 0 0 {0}\nVERTEX 1 0 {0}\r\n vertex  0 1e0 {0}\nendloop\nendfacet\n"
    text = "".join(f"solid vertex\n{facet.format(height)}endsolid vertex\n" for height in range(3))
    assert [len(item.mesh) for item in surfaces(tmp_path, "a.stl", text)] == [1, 1, 1]


def claiming(count: int, name: str = "face") -> bytes:
    right = {"face": 6, "vertex": 5}[name]
    return pyramid("binary_little_endian").replace(
        f"element {name} {right}".encode(), f"element {name} {count}".encode()
    )


STL = trimesh.creation.box().export(file_type="stl")
REFUSED = {
    "absurd.ply": (claiming(10**9), "claims 1000000000 of 'face', more than it holds"),
    "absurd_vertices.ply": (claiming(10**18, "vertex"), "claims 1000000000000000000 of 'vertex'"),
    "negative.ply": (claiming(-1), "claims -1 of 'face'"),
    "text.ply": (pyramid("ascii").replace(b"face 6", b"face 900000000"), "claims 900000000 of 'face'"),
    "mixed.ply": (pyramid("binary_little_endian", MIXED), "unexpected length.*: export it again as triangles"),
    "cut.ply": (pyramid("binary_little_endian")[:-5], "unexpected length"),
    "cut_text.ply": (pyramid("ascii")[:-12], "claims 11 rows and holds 10"),
    "more_text.ply": (pyramid("ascii") + b"1 2 3\n", "claims 11 rows and holds 12"),
    "blank.ply": (pyramid("ascii").replace(b"\n3 0 3 2 7\n", b"\n\r\r\r\r\r\r\r\r\r\r\r\r\n"), "claims 11 rows"),
    "negative_list.ply": (pyramid("ascii").replace(b"3 0 3 2 7", b"-3 0 3 2 7"), "the mesh has no faces"),
    "no_header.ply": (b"ply\nformat ascii 1.0\n", "not a PLY file with a whole header"),
    "type.ply": (pyramid("ascii").replace(b"float x", b"string x"), "cannot be read"),
    "points.ply": (pyramid("ascii").replace(b"vertex_indices", b"something"), "cannot be read|no faces"),
    "index.ply": (pyramid("ascii").replace(b"3 0 1 4", b"3 0 1 9"), "a face refers to a vertex that does"),
    "negative_index.ply": (pyramid("ascii").replace(b"3 0 1 4", b"3 0 1 -1"), "a face refers to a vertex that"),
    "nan.ply": (pyramid("ascii").replace(b"0.5 0.5 1", b"0.5 nan 1"), "'nan' among its numbers"),
    "nan_binary.ply": (pyramid("binary_little_endian").replace(struct.pack("<f", 0.5), struct.pack("<f", np.nan)),
                       "a vertex is NaN"),
    "empty.ply": (b"", "is empty"),
    "absurd.stl": (STL[:80] + struct.pack("<I", 10**9) + STL[84:], "nor the 1,000,000,000 triangles that its header"),
    "cut.stl": (STL[:-1], "nor the 12 triangles that its header claims"),
    "nothing.stl": (b"solid\nendsolid\n", "the mesh has no faces"),
    "word.stl": (b"solid\nvertex 0 0 zero\n", "'vertex 0 0 zero' is not a vertex"),
    "cut_text.stl": (b"solid\nvertex 0 0 0\n", "ends within a solid"),
    "two_vertices.stl": (b"solid\nvertex 0 0 0\nvertex 0 1 0\nendsolid", "cannot be read"),
    "inf.stl": (b"solid\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 inf 0\nendsolid", "'vertex 0 inf 0' is not a vertex"),
    "one_line.stl": (b"solid vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endsolid", "is not a vertex"),
    "solids.stl": (b"solid a\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendsolid\n" * 2001, "2,000 solids"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_damaged_files_are_refused_in_one_line_and_little_memory(name: str, tmp_path: Path) -> None:
    content, message = REFUSED[name]
    tracemalloc.start()
    with pytest.raises(SceneError, match=message) as caught:
        surfaces(tmp_path, name, content)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()
    assert str(caught.value).startswith(f"{tmp_path / name}: ")
    assert "\n" not in str(caught.value)
