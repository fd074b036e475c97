"""What ray tokens are told about the lights: the closed form for a small light, in the camera's axes."""

from dataclasses import replace

import numpy as np
import torch
from random_scenes import random_views

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.gbuffer.first_hit import first_hit, stack_channels
from rfpp.model.first_light import NoLight, UnshadowedLight
from rfpp.scene.triangles import EMISSION
from rfpp.training.views import moved

CHANNELS = UnshadowedLight.channels


def seen(rng: np.random.Generator, object_sizes=(12, 5, 1), views: int = 2) -> SceneViews:
    """A random scene with its true normals and positions."""
    sample = random_views(rng, object_sizes, views=views)
    buffers = [first_hit(sample.triangles, m, float(f), 16, 16) for m, f in zip(sample.c2w, sample.fov, strict=True)]
    stacked = [
        stack_channels(g, sample.triangles.material, float(f), CHANNELS)
        for g, f in zip(buffers, sample.fov, strict=True)
    ]
    return replace(sample, gbuffer=np.stack(stacked))


def light_maps(*samples: SceneViews) -> torch.Tensor:
    batch = RaggedBatch.pack(samples)
    light = UnshadowedLight()
    return light(light.emitters(batch), batch.c2w, batch.gbuffer.flatten(0, 1))


def test_a_small_light_gives_radiance_area_cosines_over_distance_squared():
    views = seen(np.random.default_rng(0))
    triangles = views.triangles
    light = triangles.material[:, EMISSION].sum(1) > 0
    corners = triangles.positions[light][0].astype(np.float64)
    corners = corners.mean(0) + 0.01 * (corners - corners.mean(0))  # nearly a point
    positions = triangles.positions.copy()
    positions[light] = corners
    views = replace(views, triangles=replace(triangles, positions=positions))
    maps = light_maps(views).numpy()

    centre, cross = corners.mean(0), np.cross(corners[1] - corners[0], corners[2] - corners[0])
    area, radiance = np.linalg.norm(cross) / 2, triangles.material[light][0, EMISSION].mean()
    for v in range(2):
        turn, eye = views.c2w[v, :3, :3].astype(np.float64), views.c2w[v, :3, 3]
        for row, column in np.argwhere(views.gbuffer[v, 5] < 0)[::7]:
            normal = turn @ views.gbuffer[v, :3, row, column]
            way = centre - (turn @ views.gbuffer[v, 3:, row, column] + eye)
            distance = np.linalg.norm(way)
            way /= distance
            amount = radiance * area * abs(cross @ way) / np.linalg.norm(cross) / distance**2
            expected = [*(turn.T @ way * amount), amount * max(0.0, normal @ way)]
            np.testing.assert_allclose(maps[v, :, row, column], expected, rtol=5e-3, atol=2e-3 * amount)


def test_nothing_where_nothing_is_hit_and_nothing_without_light():
    views = seen(np.random.default_rng(1))
    maps = light_maps(views)
    missed = torch.from_numpy(views.gbuffer[:, 5] == 0)[:, None].expand_as(maps)
    assert missed.any()
    assert not maps[missed].any()
    assert maps[~missed].any()
    material = views.triangles.material.copy()
    material[:, EMISSION] = 0
    assert not light_maps(replace(views, triangles=replace(views.triangles, material=material))).any()


def test_packed_scenes_keep_their_own_lights():
    rng = np.random.default_rng(2)
    samples = [seen(rng, sizes) for sizes in ((9, 4, 1), (6, 3), (30, 1))]
    together = light_maps(*samples).split(2)
    for i, sample in enumerate(samples):
        torch.testing.assert_close(together[i], light_maps(sample))


def test_lights_add_up():
    views = seen(np.random.default_rng(3), (12, 3))
    parts = []
    for lit in ([0, 1, 2], [0], [1, 2]):
        material = views.triangles.material.copy()
        material[12:, EMISSION] = 0
        material[12 + np.array(lit), EMISSION] = 1000
        parts.append(light_maps(replace(views, triangles=replace(views.triangles, material=material))))
    torch.testing.assert_close(parts[0], parts[1] + parts[2], rtol=1e-4, atol=1e-4 * parts[0].max().item())


def test_a_rigid_motion_of_scene_and_camera_changes_nothing():
    rng = np.random.default_rng(4)
    views = seen(rng)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    elsewhere = moved(views, turn * np.linalg.det(turn), np.array([0.3, -2.0, 1.0]))
    before = light_maps(views)
    torch.testing.assert_close(light_maps(elsewhere), before, rtol=1e-3, atol=1e-4 * before.abs().max().item())


def test_no_light_adds_nothing():
    batch = RaggedBatch.pack([seen(np.random.default_rng(5))])
    none = batch.gbuffer.flatten(0, 1)[:, :0]
    assert NoLight()(NoLight().emitters(batch), batch.c2w, none).shape == none.shape
