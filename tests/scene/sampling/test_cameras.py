import numpy as np
import pytest
from scene_families import family
from scipy.stats import kstest, spearmanr

from rfpp.scene.sampling.backgrounds import KINDS

FAMILY = family("quickstart")


@pytest.fixture(scope="module")
def drawn():
    """(background, camera) pairs, all kinds of background."""
    rng = np.random.default_rng(0)
    backgrounds = [FAMILY.backgrounds.sample(rng) for _ in range(400)]
    return [(b, camera) for b in backgrounds for camera in FAMILY.cameras.sample(rng, b.open_region)]


def test_ranges(drawn):
    for _, camera in drawn:
        offset = np.subtract(camera.position, camera.look_at)
        assert 1.5 - 1e-9 <= np.linalg.norm(offset) <= 2.0 + 1e-9
        assert np.abs(camera.look_at).max() <= 0.2
        assert np.abs(np.subtract(camera.up, (0, 0, 1))).max() <= 0.1
        assert 30 <= camera.fov <= 60
        assert 10 - 1e-6 <= np.degrees(np.arcsin(offset[2] / np.linalg.norm(offset))) <= 80 + 1e-6


def test_cameras_and_their_targets_are_in_front_of_every_panel(drawn):
    """Both ends of the line of sight are in a convex region in front of all panels, so no panel cuts it."""
    assert {b.kind for b, _ in drawn} == set(KINDS)
    for background, camera in drawn:
        ends = np.array([camera.position, camera.look_at])
        assert background.open_region.distances(ends).min() > 0
        assert background.open_region.distances(ends[0]).min() > FAMILY.cameras.clearance


def test_distance_and_angle_are_uniform_and_everything_is_independent(drawn):
    cameras = [camera for _, camera in drawn]
    distance = np.array([np.linalg.norm(np.subtract(c.position, c.look_at)) for c in cameras])
    fov = np.array([c.fov for c in cameras])
    assert kstest((fov - 30) / 30, "uniform").pvalue > 0.01
    assert kstest((distance - 1.5) / 0.5, "uniform").pvalue > 0.01
    columns = [distance, fov, *np.array([c.look_at for c in cameras]).T, *np.array([c.up for c in cameras]).T]
    correlation = spearmanr(np.stack(columns, axis=1)).statistic
    assert np.abs(correlation[~np.eye(8, dtype=bool)]).max() < 4.5 / np.sqrt(len(cameras))


def test_a_plane_is_seen_from_all_round_and_a_corner_from_its_open_side(drawn):
    views = {
        kind: np.array([np.subtract(c.position, c.look_at) for b, c in drawn if b.kind == kind])[:, :2]
        for kind in KINDS
    }
    azimuth = np.degrees(np.arctan2(views["plane"][:, 1], views["plane"][:, 0]))
    assert np.histogram(azimuth, bins=8, range=(-180, 180))[0].min() > 0.08 * len(azimuth)
    for kind, open_azimuth in {"wall": -90, "corner": -135, "box": -90}.items():
        x, y = views[kind].mean(axis=0)
        assert np.degrees(np.arctan2(y, x)) == pytest.approx(open_azimuth, abs=10)
