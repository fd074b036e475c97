"""Shading normals and shading groups."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from rfpp.scene.mesh import Mesh
from rfpp.scene.shading_normals import corner_normals, shading_groups


def from_trimesh(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(shape.vertices, shape.faces)


def face_normals(mesh: Mesh) -> np.ndarray:
    a, b, c = np.moveaxis(mesh.corners, 1, 0)
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def folded(degrees: float) -> Mesh:
    """Two triangles that share an edge and meet at the given angle."""
    up = np.radians(degrees)
    corners = [[0, 0, 0], [0, 1, 0], [-1, 0, 0], [np.cos(up), 0, np.sin(up)]]
    return Mesh(np.array(corners), np.array([[0, 1, 2], [1, 0, 3]]))


def test_a_smooth_sphere_has_radial_normals() -> None:
    mesh = from_trimesh(trimesh.creation.icosphere(2))
    np.testing.assert_allclose(corner_normals(mesh, smooth=True), mesh.corners, atol=0.01)


def test_a_cube_stays_flat_and_has_six_groups() -> None:
    mesh = from_trimesh(trimesh.creation.box().subdivide())
    np.testing.assert_allclose(corner_normals(mesh, smooth=True), corner_normals(mesh, smooth=False), atol=1e-6)
    groups = shading_groups(mesh, smooth=True)
    assert set(groups) == set(range(6))
    for group in range(6):
        assert np.ptp(face_normals(mesh)[groups == group], axis=0).max() < 1e-6


def test_a_cylinder_is_round_on_its_side_and_sharp_at_its_rim() -> None:
    mesh = from_trimesh(trimesh.creation.cylinder(1, 2, sections=32))
    normals, faces = corner_normals(mesh, smooth=True), face_normals(mesh)
    cap = np.abs(faces[:, 2]) > 0.5
    np.testing.assert_allclose(normals[cap], np.repeat(faces[cap][:, None], 3, axis=1), atol=1e-6)
    radial = mesh.corners[~cap] * (1, 1, 0)
    np.testing.assert_allclose(normals[~cap], radial, atol=1e-5)
    assert shading_groups(mesh, smooth=True).max() + 1 == 3


@pytest.mark.parametrize(
    ("degrees", "is_smooth"), [(5, True), (29, True), (30, True), (31, False), (90, False), (170, False)]
)
def test_thirty_degrees_is_the_crease(degrees: float, is_smooth: bool) -> None:
    mesh = folded(degrees)
    normals = corner_normals(mesh, smooth=True)
    assert np.allclose(normals[0, 0], normals[1, 1], atol=1e-6) == is_smooth  # both are the corner at vertex 0
    assert shading_groups(mesh, smooth=True).max() + 1 == (1 if is_smooth else 2)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1, atol=1e-6)


def test_faces_that_disagree_about_the_outside_do_not_mix() -> None:
    mesh = folded(5)
    turned = Mesh(mesh.vertices, np.stack([mesh.faces[0], mesh.faces[1][::-1]]))
    np.testing.assert_allclose(corner_normals(turned, True), corner_normals(turned, False), atol=1e-6)


def test_unshared_vertices_shade_as_if_shared() -> None:
    mesh = from_trimesh(trimesh.creation.icosphere(2))
    soup = Mesh(mesh.corners.reshape(-1, 3), np.arange(3 * len(mesh)).reshape(-1, 3))
    np.testing.assert_allclose(corner_normals(soup, True), corner_normals(mesh, True), atol=1e-6)
