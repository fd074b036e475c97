"""Invariances of the image, and independence of scenes and views in a batch."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from networks import network
from random_scenes import random_views

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.raycast.first_hit import CHANNELS
from rfpp.scene.triangles import SceneTriangles
from rfpp.training.augmentation import moved

VARIANTS = {
    "paper": (),
    "known_light": ("experiment=[quickstart,known_light]",),
}
MOST_CHANNELS = sum(CHANNELS.values())


@pytest.fixture(params=VARIANTS.values(), ids=VARIANTS.keys())
def net(request):
    return network(*request.param)


def some_views(rng: np.random.Generator, object_sizes=(12, 5, 1), **how) -> SceneViews:
    return random_views(rng, object_sizes, channels=MOST_CHANNELS, **how)


def packed(net, *samples: SceneViews) -> RaggedBatch:
    """Pack samples with the channels of the network."""
    count = sum(CHANNELS[name] for name in net.gbuffer_channels)
    return RaggedBatch.pack([replace(s, gbuffer=s.gbuffer[:, :count]) for s in samples])


def image(net, *samples: SceneViews) -> torch.Tensor:
    with torch.no_grad():
        return net(packed(net, *samples)).log_radiance


def reordered(views: SceneViews, objects: list[int], rng: np.random.Generator | None = None) -> SceneViews:
    """Objects in another order and, with an rng, each object's triangles too."""
    old = views.triangles
    pieces = [np.arange(old.object_offsets[o], old.object_offsets[o + 1]) for o in objects]
    rows = np.concatenate([rng.permutation(p) if rng else p for p in pieces])
    triangles = SceneTriangles(
        positions=old.positions[rows],
        normals=old.normals[rows],
        material=old.material[rows],
        object_offsets=np.concatenate([[0], np.cumsum([len(p) for p in pieces])]).astype(np.int32),
        object_names=tuple(old.object_names[o] for o in objects),
    )
    return replace(views, triangles=triangles)


def test_object_order_does_not_matter(net):
    views = some_views(np.random.default_rng(1), (9, 30, 4, 1, 1))
    torch.testing.assert_close(image(net, reordered(views, [3, 1, 4, 0, 2])), image(net, views), rtol=1e-4, atol=1e-6)


def test_triangle_order_within_objects_does_not_matter(net):
    rng = np.random.default_rng(2)
    views = some_views(rng, (9, 30, 4, 1))
    torch.testing.assert_close(image(net, reordered(views, [0, 1, 2, 3], rng)), image(net, views), rtol=1e-4, atol=1e-6)


def test_which_object_a_triangle_belongs_to_does_matter(net):
    views = some_views(np.random.default_rng(3), (10, 10, 1))
    merged = replace(
        views,
        triangles=replace(views.triangles, object_offsets=np.array([0, 20, 21], np.int32), object_names=("a", "b")),
    )
    assert not torch.allclose(image(net, merged), image(net, views), rtol=1e-3, atol=1e-6)


def test_translating_scene_and_camera_does_not_matter(net):
    views = some_views(np.random.default_rng(4), (12, 20, 1))
    shifted = moved(views, np.eye(3), np.array([0.7, -1.2, 0.4]))
    torch.testing.assert_close(image(net, shifted), image(net, views), rtol=2e-3, atol=1e-5)


def test_packed_equals_one_by_one(net):
    rng = np.random.default_rng(5)
    samples = [some_views(rng, sizes) for sizes in ((3, 1), (40, 7, 7, 1, 1), (5, 90, 1), (1,))]
    together = image(net, *samples)
    for i, sample in enumerate(samples):
        torch.testing.assert_close(together[i], image(net, sample)[0], rtol=1e-4, atol=1e-6)


def test_views_do_not_see_each_other(net):
    views = some_views(np.random.default_rng(6), (12, 5, 1), views=3)
    single = [
        replace(views, c2w=views.c2w[v : v + 1], fov=views.fov[v : v + 1], gbuffer=views.gbuffer[v : v + 1], image=None)
        for v in range(3)
    ]
    together = image(net, views)
    for v in range(3):
        torch.testing.assert_close(together[0, v], image(net, single[v])[0, 0], rtol=1e-4, atol=1e-6)


def test_gradients_of_a_packed_batch_are_the_sum_of_its_scenes(net):
    net.train()
    rng = np.random.default_rng(7)
    samples = [some_views(rng, sizes) for sizes in ((20, 3, 1), (6, 1))]

    def gradients(*batch):
        net.zero_grad()
        net(packed(net, *batch)).log_radiance.sum().backward()
        return torch.cat([p.grad.flatten() for p in net.parameters() if p.grad is not None])

    torch.testing.assert_close(gradients(*samples), gradients(samples[0]) + gradients(samples[1]), rtol=1e-3, atol=1e-4)
