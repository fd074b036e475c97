import numpy as np
import pytest
import trimesh

from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.objects.deformation import DEFORMATIONS, deformed
from rfpp.scene.sampling.objects.refinement import is_closed
from rfpp.scene.sampling.objects.solid import volume

BAR = trimesh.creation.box(extents=(0.4, 0.3, 2.0))
HALVES = [np.array(half) for half in ([0.2, 0.15, 1.0], [1.0, 1.0, 1.0], [0.9, 0.1, 1.0])]


def drawn(name, half, seed):
    return DEFORMATIONS[name](np.random.default_rng(seed), half)


@pytest.mark.parametrize("half", HALVES, ids=str)
@pytest.mark.parametrize("name", DEFORMATIONS)
def test_maps_keep_the_handedness_of_space_everywhere_in_the_box(name, half):
    points = np.random.default_rng(0).uniform(-1, 1, (400, 3)) * half
    for seed in range(20):
        move = drawn(name, half, seed)
        columns = [(move(points + step) - move(points - step)) / 2e-5 for step in 1e-5 * np.eye(3)]
        assert np.linalg.det(np.stack(columns, axis=2)).min() > 0.02


def test_twist_keeps_volume_and_heights_and_taper_narrows_one_end():
    half = HALVES[0]
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3)) * half
    twisted, tapered = drawn("twist", half, 0)(points), drawn("taper", half, 0)(points)
    assert np.array_equal(twisted[:, 2], points[:, 2])
    assert np.linalg.norm(twisted[:, :2], axis=1) == pytest.approx(np.linalg.norm(points[:, :2], axis=1))
    factor = tapered[:, 0] / points[:, 0]
    assert np.all(np.diff(factor[np.argsort(points[:, 2])]) < 0)
    assert 0.25 <= factor.min() < factor.max() <= 1


def test_flat_sides_curve_along_the_longest_side_whatever_axis_it_lies_on():
    for axis in range(3):
        bar = Mesh(np.roll(BAR.vertices, axis, axis=1), BAR.faces)
        for seed in range(6):
            result = deformed(np.random.default_rng(seed), bar, 300)
            assert len(result) > 250
            assert is_closed(result)
            assert volume(result) > 0.05
            assert np.ptp(result.vertices, axis=0).argmax() in (0, 2)
