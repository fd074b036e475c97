"""Curves through keys: splines, monotone curves and rotations."""

from itertools import pairwise

import numpy as np
import pytest

from rfpp.errors import SceneError
from rfpp.inference.motion.interpolation import monotone, slerp, spline
from rfpp.scene.spec import rotation_matrix

TIMES = [0.5, 1.0, 2.5, 3.0]
PLACES = np.random.default_rng(0).uniform(-1, 1, (4, 3))


@pytest.mark.parametrize("kind", [spline, monotone])
def test_curves_pass_through_keys_and_are_constant_outside(kind):
    curve = kind(TIMES, PLACES)
    for time, place in zip(TIMES, PLACES, strict=True):
        np.testing.assert_allclose(curve(time), place, atol=1e-12)
    np.testing.assert_array_equal(curve(0.0), curve(0.5))
    np.testing.assert_array_equal(curve(9.0), curve(3.0))
    np.testing.assert_array_equal(kind([1.0], PLACES[:1])(7.0), PLACES[0])
    np.testing.assert_allclose(kind([0, 2], PLACES[:2])(0.5), 0.75 * PLACES[0] + 0.25 * PLACES[1])


def test_splines_are_smooth_at_keys_and_linear_for_constant_speed():
    curve, step = spline(TIMES, PLACES), 1e-5
    for key in TIMES[1:-1]:
        before, after = curve(key) - curve(key - step), curve(key + step) - curve(key)
        np.testing.assert_allclose(before, after, atol=1e-8)
        assert np.linalg.norm(before) > 1e-6
    constant = spline([0, 1, 4], [[0.0], [1.0], [4.0]])
    np.testing.assert_allclose([constant(t)[0] for t in (0.3, 2.0, 3.7)], [0.3, 2.0, 3.7])


def test_monotone_curves_stay_within_their_keys():
    values = np.array([monotone([0, 1, 2, 3], [0.0, 0.0, 1.0, 1.0])(t) for t in np.linspace(0, 3, 301)])
    assert values.min() >= 0 and values.max() <= 1
    assert (np.diff(values) >= 0).all()
    curve = monotone([0.0, 0.1, 0.7], [[1.0, 0.0], [1.0, 0.1], [1.0, 0.3]])
    assert all(curve(t)[0] == 1 for t in np.linspace(0, 0.7, 1001))


def test_slerp_takes_the_shortest_rotation_at_constant_speed():
    keys = [[20.0, -35.0, 70.0], [-50.0, 60.0, 10.0], [0.0, 90.0, 30.0]]
    curve = slerp([0, 1, 2], keys)
    for time, key in enumerate(keys):
        np.testing.assert_allclose(rotation_matrix(tuple(curve(time))), rotation_matrix(tuple(key)), atol=1e-7)
    poses = [rotation_matrix(tuple(curve(t))) for t in np.linspace(0, 1, 9)]
    steps = [np.arccos((np.trace(a.T @ b) - 1) / 2) for a, b in pairwise(poses)]
    whole = np.arccos((np.trace(poses[0].T @ poses[-1]) - 1) / 2)
    np.testing.assert_allclose(steps, whole / 8, rtol=1e-6)


def test_ambiguous_rotations_are_refused():
    with pytest.raises(SceneError, match="180 degrees or more from time 1 to 3: add a key between"):
        slerp([0, 1, 3], [[0, 0, 0], [0, 0, 90], [0, 0, 360]])
