import warnings
from itertools import pairwise

import numpy as np
import pytest

from rfpp.errors import SceneError
from rfpp.inference.motion.interpolation import bounded, flowing, turning
from rfpp.scene.spec import rotation_matrix

TIMES = [0.5, 1.0, 2.5, 3.0]
PLACES = np.random.default_rng(0).uniform(-1, 1, (4, 3))


@pytest.mark.parametrize("kind", [flowing, bounded])
def test_curves_hit_their_keys_and_hold_the_first_and_the_last(kind):
    curve = kind(TIMES, PLACES)
    for time, place in zip(TIMES, PLACES, strict=True):
        np.testing.assert_allclose(curve(time), place, atol=1e-12)
    np.testing.assert_array_equal(curve(0.0), curve(0.5))
    np.testing.assert_array_equal(curve(9.0), curve(3.0))
    np.testing.assert_array_equal(kind([1.0], PLACES[:1])(7.0), PLACES[0])


@pytest.mark.parametrize("kind", [flowing, bounded])
def test_two_keys_are_a_straight_line(kind):
    np.testing.assert_allclose(kind([0, 2], PLACES[:2])(0.5), 0.75 * PLACES[0] + 0.25 * PLACES[1])


def test_places_flow_through_keys_without_a_kink():
    curve, step = flowing(TIMES, PLACES), 1e-5
    for key in TIMES[1:-1]:
        before, after = curve(key) - curve(key - step), curve(key + step) - curve(key)
        np.testing.assert_allclose(before, after, atol=1e-8)
        assert np.linalg.norm(before) > 1e-6


def test_even_motion_stays_even_over_uneven_keys():
    curve = flowing([0, 1, 4], [[0.0], [1.0], [4.0]])
    np.testing.assert_allclose([curve(t)[0] for t in (0.3, 2.0, 3.7)], [0.3, 2.0, 3.7])


def test_materials_never_leave_their_keys():
    curve = bounded([0, 1, 2, 3], [0.0, 0.0, 1.0, 1.0])
    values = np.array([curve(t) for t in np.linspace(0, 3, 301)])
    assert values.min() >= 0 and values.max() <= 1
    assert (np.diff(values) >= 0).all()


def test_materials_at_their_limit_stay_valid():
    curve = bounded([0.0, 0.1, 0.7], [[1.0, 0.0], [1.0, 0.1], [1.0, 0.3]])
    assert all(curve(t)[0] == 1 for t in np.linspace(0, 0.7, 1001))


def test_rotations_turn_evenly_about_one_axis():
    curve = turning([0, 2], [[0, 0, 0], [0, 0, 120]])
    for time in (0.5, 1.0, 1.9):
        np.testing.assert_allclose(curve(time), [0, 0, 60 * time], atol=1e-9)


def test_slerp_goes_the_shortest_way_at_even_speed():
    keys = [[20.0, -35.0, 70.0], [-50.0, 60.0, 10.0], [0.0, 90.0, 30.0]]
    curve = turning([0, 1, 2], keys)
    for time, key in enumerate(keys):
        np.testing.assert_allclose(rotation_matrix(tuple(curve(time))), rotation_matrix(tuple(key)), atol=1e-7)
    poses = [rotation_matrix(tuple(curve(t))) for t in np.linspace(0, 1, 9)]
    steps = [np.arccos((np.trace(a.T @ b) - 1) / 2) for a, b in pairwise(poses)]
    whole = np.arccos((np.trace(poses[0].T @ poses[-1]) - 1) / 2)
    np.testing.assert_allclose(steps, whole / 8, rtol=1e-6)


def test_a_right_angle_about_y_loses_nothing():
    curve = turning([0, 1], [[0, 80, 40], [0, 100, 40]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        angles = tuple(curve(0.5))
    np.testing.assert_allclose(rotation_matrix(angles), rotation_matrix((0.0, 90.0, 40.0)), atol=1e-7)


def test_a_turn_whose_way_is_ambiguous_is_refused():
    with pytest.raises(SceneError, match="180 degrees or more from time 1 to 3: put a key between"):
        turning([0, 1, 3], [[0, 0, 0], [0, 0, 90], [0, 0, 360]])
