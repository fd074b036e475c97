import numpy as np
import pytest
from small_data import make

from rfpp.raycast.first_hit import first_hit, stack_channels
from rfpp.scene.triangles import DIFFUSE, EMISSION, SPECULAR
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.views import AllViews
from rfpp.training.augmentation import ColorPermutation, RigidMotion

CHANNELS = ("albedo", "normal", "position")


@pytest.fixture(scope="module")
def split(tmp_path_factory):
    manifest = make(tmp_path_factory.mktemp("augmented") / "small", splits={"train": 2})
    return ShardSplit(manifest.root, "train")


def test_moving_scene_and_camera_leaves_gbuffers_and_images(split):
    views = AllViews(split, CHANNELS)[0]
    rng = np.random.default_rng(0)
    turned = RigidMotion(rotation=1.0, translation=0.25)(views, CHANNELS, rng)
    assert not np.allclose(turned.triangles.positions, views.triangles.positions, atol=0.1)
    np.testing.assert_array_equal(turned.image, views.image)
    for v in range(2):
        fov = float(turned.fov[v])
        seen = first_hit(turned.triangles, turned.c2w[v], fov, 8, 8)
        channels = stack_channels(seen, turned.triangles.material, fov, CHANNELS)
        agreeing = np.isclose(channels, views.gbuffer[v], atol=2e-3).all(axis=0)
        assert agreeing.mean() > 0.95  # a pixel on an edge may see the other side of it


def test_a_move_is_rigid_and_right_handed(split):
    views = AllViews(split, CHANNELS)[0]
    turned = RigidMotion(rotation=2.0, translation=1.0)(views, CHANNELS, np.random.default_rng(1))
    before, after = (np.linalg.norm(np.diff(v.triangles.positions, axis=1), axis=-1) for v in (views, turned))
    np.testing.assert_allclose(after, before, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(turned.c2w[:, :3, :3]), 1, rtol=1e-5)


def test_augmentation_has_the_documented_spread(split):
    views = AllViews(split, CHANNELS)[0]
    motion = RigidMotion(rotation=0.0, translation=0.25)
    rng = np.random.default_rng(2)
    shifts = np.array([motion(views, CHANNELS, rng).c2w[0, :3, 3] - views.c2w[0, :3, 3] for _ in range(300)])
    np.testing.assert_allclose(shifts.std(axis=0), 0.25, rtol=0.15)
    np.testing.assert_allclose(shifts.mean(axis=0), 0, atol=0.05)


def test_color_channels_trade_places_everywhere_at_once(split):
    views = AllViews(split, CHANNELS)[0]
    rng = np.random.default_rng(0)
    for _ in range(8):
        swapped = ColorPermutation()(views, CHANNELS, rng)
        order = [int(np.argmax(np.isclose(swapped.image[0, c], views.image[0]).all((1, 2)))) for c in range(3)]
        assert sorted(order) == [0, 1, 2]
        for columns in (DIFFUSE, SPECULAR, EMISSION):
            before, after = (v.triangles.material[:, columns] for v in (views, swapped))
            np.testing.assert_array_equal(after, before[:, order])
        np.testing.assert_array_equal(swapped.gbuffer[:, :3], views.gbuffer[:, order])
        np.testing.assert_array_equal(swapped.gbuffer[:, 3:], views.gbuffer[:, 3:])
        np.testing.assert_array_equal(swapped.triangles.material[:, 6], views.triangles.material[:, 6])
