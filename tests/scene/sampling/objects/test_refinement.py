import numpy as np
import pytest

from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.objects.refinement import is_closed, refined

TETRAHEDRON = Mesh(
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
)


def vector_areas(mesh):
    return np.cross(mesh.corners[:, 1] - mesh.corners[:, 0], mesh.corners[:, 2] - mesh.corners[:, 0]) / 2


def volume(mesh):
    return np.einsum("fi,fi->", mesh.corners[:, 0], np.cross(mesh.corners[:, 1], mesh.corners[:, 2])) / 6


@pytest.mark.parametrize("target", [4, 5, 6, 7, 50, 51, 777, 1200])
def test_a_closed_mesh_gets_the_even_count_at_the_target_and_keeps_its_surface(target):
    fine = refined(TETRAHEDRON, target)
    assert len(fine) == target // 2 * 2
    assert is_closed(fine)
    assert volume(fine) == pytest.approx(1 / 6, rel=1e-5)
    areas = np.linalg.norm(vector_areas(fine), axis=1)
    assert areas.sum() == pytest.approx(1.5 + np.sqrt(3) / 2, rel=1e-5)
    # Outward orientation is kept face by face: every normal is one of the four of the tetrahedron.
    normals = vector_areas(fine) / areas[:, None]
    original = vector_areas(TETRAHEDRON) / np.linalg.norm(vector_areas(TETRAHEDRON), axis=1, keepdims=True)
    assert (normals @ original.T).max(axis=1) == pytest.approx(1, abs=1e-4)


def test_an_open_mesh_gets_the_target_or_one_below():
    square = Mesh(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    assert not is_closed(square)
    assert [len(refined(square, n)) for n in (2, 3, 4, 6)] == [2, 2, 4, 6]
    assert len(refined(square, 333)) in (332, 333)


def test_a_mesh_that_is_fine_enough_is_left_alone_and_inputs_are_not_changed():
    before = TETRAHEDRON.vertices.copy(), TETRAHEDRON.faces.copy()
    same = refined(TETRAHEDRON, 3)
    assert (same.vertices == before[0]).all()
    assert (same.faces == before[1]).all()
    refined(TETRAHEDRON, 100)
    assert (TETRAHEDRON.vertices == before[0]).all()
    assert (TETRAHEDRON.faces == before[1]).all()
