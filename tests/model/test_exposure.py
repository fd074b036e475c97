"""Exposure: light is linear, and the amount that arrives has a closed form for a small light and a small surface."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from networks import network
from random_scenes import random_views

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.model.exposure import MeanIrradianceExposure
from rfpp.raycast.first_hit import DIRECT_CHANNELS
from rfpp.scene.triangles import EMISSION, SceneTriangles
from rfpp.training.augmentation import moved

KNOWN_LIGHT = ("experiment=[quickstart,known_light]",)


def triangle(center, x, y) -> np.ndarray:
    """A triangle with this centroid, spanned by x and y: its area is 3/2 |x × y|, its normal along x × y."""
    center, x, y = (np.asarray(v, dtype=float) for v in (center, x, y))
    return np.stack([center + x, center + y, center - x - y])


def scene(*objects: tuple[np.ndarray, float]) -> RaggedBatch:
    """Single-triangle objects, each with the radiance it emits."""
    views = random_views(np.random.default_rng(0), (1,) * len(objects))
    material = views.triangles.material.copy()
    material[:, EMISSION] = np.array([emission for _, emission in objects])[:, None]
    triangles = replace(
        views.triangles, positions=np.stack([t for t, _ in objects]).astype(np.float32), material=material
    )
    return RaggedBatch.pack([replace(views, triangles=triangles)])


FLOOR = triangle((0, 0, 0), (0.1, 0, 0), (0, 0.1, 0))  # area 0.015
LIGHT = triangle((0, 0, 2), (0.01, 0, 0), (0, 0.01, 0))  # area 1.5e-4


def test_arriving_light_of_a_facing_light_is_radiance_area_over_distance_squared():
    exposure = MeanIrradianceExposure()(scene((FLOOR, 0), (LIGHT, 3000)))
    torch.testing.assert_close(exposure, torch.tensor([3000 * 1.5e-4 / 2**2]), rtol=3e-3, atol=0)  # small, not points


@pytest.mark.parametrize("degrees", [0, 40, 75, 140])
def test_a_turned_light_sends_less_by_the_cosine_from_either_side(degrees):
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    turned = triangle((0, 0, 2), (0.01 * cos, 0, 0.01 * sin), (0, 0.01, 0))
    straight = MeanIrradianceExposure()(scene((FLOOR, 0), (LIGHT, 3000)))
    torch.testing.assert_close(
        MeanIrradianceExposure()(scene((FLOOR, 0), (turned, 3000))), straight * abs(cos), rtol=5e-3, atol=0
    )


def test_lights_add_up_and_objects_count_by_area():
    other = triangle((1, 0, 1.5), (0.01, 0, 0), (0, 0, 0.02))
    one, two = (MeanIrradianceExposure()(scene((FLOOR, 0), light)) for light in ((LIGHT, 3000), (other, 1000)))
    torch.testing.assert_close(MeanIrradianceExposure()(scene((FLOOR, 0), (LIGHT, 3000), (other, 1000))), one + two)
    wall = triangle((0.5, 0, 0.5), (0, 0.1, 0), (0, 0, 0.2))  # twice the floor's area
    on_wall = MeanIrradianceExposure()(scene((wall, 0), (LIGHT, 3000)))
    torch.testing.assert_close(
        MeanIrradianceExposure()(scene((FLOOR, 0), (wall, 0), (LIGHT, 3000))),
        (one + 2 * on_wall) / 3,
        rtol=1e-4,
        atol=0,
    )


def test_without_light_or_without_surfaces_the_exposure_is_one():
    for objects in ([(FLOOR, 0)], [(LIGHT, 3000)]):
        assert MeanIrradianceExposure()(scene(*objects)).tolist() == [1]


def test_exposure_of_a_packed_scene_is_its_own_and_a_rigid_motion_does_not_change_it():
    rng = np.random.default_rng(2)
    samples = [random_views(rng, sizes) for sizes in ((9, 4, 1), (3, 1, 2, 1), (30, 1))]
    together = MeanIrradianceExposure()(RaggedBatch.pack(samples))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for i, sample in enumerate(samples):
        torch.testing.assert_close(together[i : i + 1], MeanIrradianceExposure()(RaggedBatch.pack([sample])))
        elsewhere = moved(sample, turn * np.linalg.det(turn), np.array([0.3, -2.0, 1.0]))
        torch.testing.assert_close(
            together[i : i + 1], MeanIrradianceExposure()(RaggedBatch.pack([elsewhere])), rtol=1e-4, atol=0
        )


def with_brighter_lights(views: SceneViews, factor: float) -> SceneViews:
    """Multiply the scene's emission and the light in its G-buffer."""
    old: SceneTriangles = views.triangles
    material = old.material.copy()
    material[:, EMISSION] *= factor
    gbuffer = views.gbuffer.copy()
    gbuffer[:, 10:19] *= factor
    return replace(views, triangles=replace(old, material=material), gbuffer=gbuffer)


@pytest.mark.parametrize("factor", [0.01, 2.0, 50.0])
def test_brighter_lights_make_the_image_brighter_by_the_same(factor):
    net = network(*KNOWN_LIGHT)
    assert net.gbuffer_channels[4:7] == (*DIRECT_CHANNELS, "reflected_light")
    views = random_views(np.random.default_rng(3), (12, 6, 1, 1), channels=19)

    def radiance(sample):
        with torch.no_grad():
            return 10 ** net(RaggedBatch.pack([sample])).log_radiance.double() - 1

    before = radiance(views)
    assert before.abs().mean() > 1e-3
    torch.testing.assert_close(radiance(with_brighter_lights(views, factor)), factor * before, rtol=1e-3, atol=1e-5)
