import numpy as np
import pytest

from rfpp.errors import SceneError
from rfpp.scene.refinement import is_closed
from rfpp.scene.shapes import KINDS, ProceduralShapes

ALL_KINDS = ProceduralShapes(list(KINDS))


def volume(mesh):
    corners = mesh.corners.astype(np.float64)
    return np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("target", [12, 50, 151, 300, 1200])
def test_every_kind_is_closed_outward_normalised_and_of_the_asked_count(kind, target):
    source = ProceduralShapes([kind])
    for seed in range(6):
        mesh = source.sample(np.random.default_rng([seed, target]), target)
        assert len(mesh) == target // 2 * 2
        assert is_closed(mesh)
        assert volume(mesh) > 0
        assert mesh.vertices.mean(axis=0) == pytest.approx(0, abs=1e-5)
        assert np.linalg.norm(mesh.vertices, axis=1).max() == pytest.approx(0.5, abs=1e-5)


def test_the_same_seed_gives_the_same_shape_and_another_seed_another():
    first, again, other = (ALL_KINDS.sample(np.random.default_rng(s), 200) for s in (1, 1, 2))
    assert np.array_equal(first.vertices, again.vertices)
    assert np.array_equal(first.faces, again.faces)
    assert first.vertices.shape != other.vertices.shape or not np.allclose(first.vertices, other.vertices)


def test_shapes_vary_in_how_much_of_their_sphere_they_fill():
    rng = np.random.default_rng(0)
    filled = [volume(ALL_KINDS.sample(rng, 100)) / (np.pi / 6) for _ in range(150)]
    assert np.percentile(filled, 5) < 0.1
    assert np.percentile(filled, 95) > 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_two_shapes_of_a_kind_differ_in_proportion(kind):
    rng = np.random.default_rng(1)
    source = ProceduralShapes([kind])
    sides = np.array([np.ptp(source.sample(rng, 100).vertices, axis=0) for _ in range(20)])
    assert (sides.std(axis=0) > 0.02).all()


def test_wrong_requests_are_refused_by_name():
    with pytest.raises(SceneError, match="'teapot': choose from superellipsoid"):
        ProceduralShapes(["teapot"])
    with pytest.raises(SceneError, match="kinds: the list is empty"):
        ProceduralShapes([])
    with pytest.raises(SceneError, match="11 triangles are too few"):
        ALL_KINDS.sample(np.random.default_rng(0), 11)
