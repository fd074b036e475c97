import numpy as np
import pytest

from rfpp.errors import SceneError
from rfpp.scene.sampling.open_region import OpenRegion

FLOOR = OpenRegion(np.array([[0.0, 0.0, 1.0]]), np.array([-0.5]))


def draw(rng, open_region=FLOOR, elevation=(0, 90), clearance=0.0, others=(), spacing=0.0):
    return open_region.draw_position(rng, np.zeros(3), 2.0, elevation, clearance, np.reshape(others, (-1, 3)), spacing)


def test_directions_are_uniform_over_the_hemisphere():
    rng = np.random.default_rng(0)
    points = np.array([draw(rng) for _ in range(4000)]) / 2
    assert np.linalg.norm(points, axis=1) == pytest.approx(1)
    # Equal areas: the height is uniform on [0, 1] and the azimuth has no preference.
    assert np.quantile(points[:, 2], [0.25, 0.5, 0.75]) == pytest.approx([0.25, 0.5, 0.75], abs=0.03)
    assert points[:, :2].mean(axis=0) == pytest.approx(0, abs=0.04)


def test_elevation_and_clearance_are_kept():
    rng = np.random.default_rng(0)
    tilted = OpenRegion(np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 0.0]]), np.array([-0.3, -0.4]))
    for _ in range(200):
        point = draw(rng, tilted, elevation=(20, 50), clearance=0.25)
        assert 20 <= np.degrees(np.arcsin(point[2] / 2)) <= 50
        assert (tilted.distances(point) > 0.25).all()


def test_others_are_kept_at_a_distance():
    rng = np.random.default_rng(0)
    other = np.array([0.0, 0.0, 2.0])
    assert min(np.linalg.norm(draw(rng, others=other, spacing=1.0) - other) for _ in range(300)) > 1.0


def test_an_impossible_request_ends_in_one_line():
    with pytest.raises(SceneError, match="widen the elevation or lower clearance, spacing or count"):
        draw(np.random.default_rng(0), clearance=5.0)
