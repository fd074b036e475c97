"""Meshes: files in and out, normalization, decimation, degenerate faces."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from rfpp.errors import SceneError, UserError
from rfpp.scene.io.mesh_files import load_mesh, save_mesh
from rfpp.scene.mesh import (
    Mesh,
    decimated,
    distinct,
    normalized,
    same_positions,
    slimness,
    welded,
    without_degenerate_faces,
)


def from_trimesh(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(shape.vertices, shape.faces)


def soup(mesh: Mesh) -> Mesh:
    """The same triangles without shared vertices, as an STL file stores them."""
    return Mesh(mesh.corners.reshape(-1, 3), np.arange(3 * len(mesh)).reshape(-1, 3))


@pytest.fixture
def sphere() -> Mesh:
    return from_trimesh(trimesh.creation.icosphere(3))


def test_obj_reads_back_exactly(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    mesh = Mesh(
        rng.normal(size=(50, 3)) * 10.0 ** rng.integers(-6, 6, (50, 1)), rng.permutation(50)[:48].reshape(-1, 3)
    )
    save_mesh(mesh, tmp_path / "mesh.obj")
    np.testing.assert_array_equal(load_mesh(tmp_path / "mesh.obj").corners, mesh.corners)
    assert os.listdir(tmp_path) == ["mesh.obj"], "a temporary file was left behind"


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_reads_what_others_export(tmp_path: Path, sphere: Mesh, suffix: str) -> None:
    path = tmp_path / f"sphere.{suffix}"
    trimesh.Trimesh(sphere.vertices, sphere.faces).export(path)
    np.testing.assert_allclose(load_mesh(path).corners, sphere.corners, atol=1e-6)


BAD_MESHES = {
    "missing.obj": (None, "no such mesh file"),
    "index.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 7\n", "index 6 is out of bounds"),
    "zero.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "'f 0 1 2' cannot be read"),
    "relative.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf -4 -2 -1\n", "'f -4 -2 -1' cannot be read.*positive indices"),
    "slashes.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 9/1\n", "index 8 is out of bounds"),
    "nan.obj": ("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "'v nan 0 0' cannot be read"),
    "inf.obj": ("v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n", "'v inf 0 0' cannot be read"),
    "huge.obj": ("v 0 0 0\nv 1e60 0 0\nv 0 1 0\nf 1 2 3\n", "NaN or infinite"),
    "word.obj": ("v 0 zero 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "cannot be read"),
    "points.obj": ("v 0 0 0\n", "no faces"),
    "empty.obj": ("", "is empty"),
    "text.ply": ("this is no mesh\n", "is not a PLY file"),
    "index.ply": (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n",
        "a face refers to a vertex that does not exist",
    ),
    "text.stl": ("this is no mesh\n", "neither text nor"),
    "mesh.fbx": ("", "'.fbx' is not a mesh format"),
}


@pytest.mark.parametrize("name", BAD_MESHES)
def test_a_bad_mesh_is_one_line_naming_the_file(tmp_path: Path, name: str) -> None:
    content, message = BAD_MESHES[name]
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(SceneError, match=message) as caught:
        load_mesh(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_full_disk_is_named_and_leaves_nothing(tmp_path: Path, sphere: Mesh, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(UserError, match=r"mesh\.obj: cannot be written \(No space left on device\)"):
        save_mesh(sphere, tmp_path / "mesh.obj")
    assert os.listdir(tmp_path) == []


def test_normalized_has_its_mean_at_the_origin_and_radius_one_half(sphere: Mesh) -> None:
    moved = Mesh(sphere.vertices * (3.0, 1.0, 0.2) + (100.0, -7.0, 3.0), sphere.faces)
    result = normalized(moved).vertices
    np.testing.assert_allclose(result.mean(axis=0), 0, atol=1e-5)
    assert np.linalg.norm(result, axis=1).max() == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize("target", [4, 13, 50, 200, 777])
@pytest.mark.parametrize("unshared", [False, True])
@pytest.mark.parametrize(
    "shape",
    [
        trimesh.creation.icosphere(4),
        trimesh.creation.torus(1, 0.3),
        trimesh.creation.cylinder(1, 2, sections=200),  # the slivers of its caps stop an edge collapse
        trimesh.creation.annulus(0.5, 1, 1),
    ],
    ids=["sphere", "torus", "cylinder", "annulus"],
)
def test_decimation_never_exceeds_its_target(shape: trimesh.Trimesh, target: int, unshared: bool) -> None:
    mesh = soup(from_trimesh(shape)) if unshared else from_trimesh(shape)
    result = decimated(mesh, target)
    assert 0 < len(result) <= target
    assert len(without_degenerate_faces(result)) == len(result)
    assert np.isin(np.arange(len(result.vertices)), result.faces).all()


def test_decimation_keeps_the_shape_and_stops_at_the_target(sphere: Mesh) -> None:
    result = decimated(sphere, 300)
    assert len(result) == 300
    np.testing.assert_allclose(np.linalg.norm(result.vertices, axis=1), 1, atol=0.02)


def test_zero_area_triangles_are_dropped_at_any_scale() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [9, 9, 9]])
    faces = np.array([[0, 1, 2], [0, 1, 1], [0, 1, 3]])
    for scale in (1e-6, 1.0, 1e6):
        result = without_degenerate_faces(Mesh(vertices * scale, faces))
        assert len(result) == 1
        assert len(result.vertices) == 3
    with pytest.raises(SceneError, match="every triangle has zero area"):
        without_degenerate_faces(Mesh(vertices, faces[1:]))


def test_slimness_is_the_height_over_the_longest_side_at_any_scale() -> None:
    vertices = np.array([[0, 0, 0], [4, 0, 0], [1, 1, 0], [1, 1e-3, 0], [0, 0, 0]])
    mesh = Mesh(1e4 * vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 4, 0]]))
    assert slimness(mesh) == pytest.approx([0.25, 0.25e-3, 0], rel=1e-5)


def test_welding_joins_equal_positions_only(sphere: Mesh) -> None:
    result = welded(soup(sphere))
    assert len(result.vertices) == len(sphere.vertices)
    np.testing.assert_array_equal(result.corners, sphere.corners)


@pytest.mark.parametrize("mixers", [None, 0])
def test_equal_positions_are_found_also_where_their_keys_collide(mixers: int | None, monkeypatch) -> None:
    if mixers is not None:
        monkeypatch.setattr("rfpp.scene.mesh._MIXERS", np.full(3, mixers, np.uint64))  # every key is that of z, or none
    rng = np.random.default_rng(0)
    for dtype in (np.float32, np.float64):
        positions = rng.integers(-2, 3, (400, 3)).astype(dtype)
        positions[positions == 0] *= rng.choice([-1, 1], np.count_nonzero(positions == 0))
        expected, index = np.unique(positions + 0.0, axis=0, return_inverse=True)
        found, number = distinct(positions)
        np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal(number, index.reshape(-1))
        first, group = same_positions(positions)
        np.testing.assert_array_equal(positions[first][group], positions)
        assert len(first) == len(expected)
