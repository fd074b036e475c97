"""Scenes labeled by radiosity: images of the renderer, and light at surfaces."""

import dataclasses

import numpy as np
import pytest
import torch
from known_scenes import look_at, material, pack, square
from small_data import make

from rfpp.batch import RaggedBatch
from rfpp.errors import ShardError
from rfpp.inference.radiosity_engine import RadiosityEngine
from rfpp.inference.radiosity_labels import RadiosityLabels, token_light
from rfpp.radiosity.radiosity import Radiosity
from rfpp.reference import cycles
from rfpp.shards.dataset import ShardSplit, find_sample
from rfpp.shards.sample import decode, encode
from rfpp.shards.views import AllViews

CYCLES = cycles.CyclesSettings(
    samples=16, adaptive_threshold=0.0, denoise=False, max_bounces=8, diffuse_bounces=8, glossy_bounces=8,
    clamp_direct=0.0, clamp_indirect=0.0, caustics=True, blur_glossy=0.0, light_threshold=0.0, filter_width=1.5, seed=0,
    threads=1,
)  # fmt: skip
LABELS = RadiosityLabels(CYCLES, light_samples=4, points=1, token_bounces=2, seed=0)


def floor_under_a_light(height: float):
    """A white floor of edge 1 and a light of edge 0.1 above its center."""
    floor = square(1.0), material(diffuse=0.8)
    light = square(0.1, z=height), material(emission=100.0)
    return pack(floor, light)


def light_of(triangles, bounces=2):
    return token_light(RadiosityEngine(Radiosity(), torch.device("cpu"), torch.float32), triangles, bounces)


def test_light_of_a_floor_is_what_the_light_sends_there():
    light = light_of(floor_under_a_light(2.0))
    lit = light[0][np.isfinite(light[0]).all((1, 2))]
    brightest = lit[lit[:, 0].sum(-1).argmax()]
    x, y = np.meshgrid(*2 * [(np.arange(50) + 0.5) / 50 - 0.5])
    expected = (
        100 * 0.1**2 / np.pi * 4 / (x**2 + y**2 + 4) ** 2
    ).mean()  # L A cos cos / (π r²), averaged over the floor
    assert brightest[0] == pytest.approx([expected] * 3, rel=0.05)


def test_light_grows_with_every_bounce_and_falls_with_distance():
    near, far = (np.nanmax(light_of(floor_under_a_light(height)), axis=1) for height in (1.0, 3.0))
    assert (near[0, 0] > 3 * far[0, 0]).all()
    box = pack((square(1.0), material(diffuse=0.8)), (square(1.0, z=1.0), material(diffuse=0.8, emission=1.0)))
    light = light_of(box)[0]
    steps = np.diff(light[np.isfinite(light).all((1, 2))], axis=1)
    assert (steps >= -1e-6).all() and steps.max() > 0.003


def test_octants_without_a_surface_have_no_light():
    light = light_of(floor_under_a_light(2.0))
    assert np.isnan(light).any() and np.isfinite(light).any()
    assert light.shape == (2, 8, 3, 3)


def test_images_are_those_of_the_unrefined_renderer():
    triangles = floor_under_a_light(2.0)
    c2w, fov = look_at((0.0, -1.5, 1.5))[None].astype(np.float32), np.array([40.0], np.float32)
    labels = LABELS.labels("train", triangles, c2w, fov, 16, noise=0)
    assert labels.images.shape == (1, 16, 16, 3)
    center = labels.images[0, 8, 8]
    assert center == pytest.approx([0.8 * 100 * 0.01 / np.pi / 4] * 3, rel=0.1)


def test_other_splits_are_path_traced(monkeypatch):
    seeds = []
    black = np.zeros((1, 4, 4, 3), np.float32)
    monkeypatch.setattr(cycles, "render", lambda *args: seeds.append(args[-1].seed) or black)
    for split in ("train_newviews", "validation", "test"):
        labels = LABELS.labels(split, floor_under_a_light(2.0), np.eye(4)[None], np.array([40.0]), 4, noise=7)
        assert labels.token_light is None
    assert seeds == [7, 7, 7]


@pytest.fixture(scope="module")
def labeled(tmp_path_factory):
    groups = {"scene": "boxes", "reference": "radiosity"}
    made = make(tmp_path_factory.mktemp("data") / "labeled", reference=LABELS, groups=groups, splits={"train": 2})
    return made.root


def test_the_light_of_every_object_reaches_the_tokens_of_a_batch(labeled):
    sample = find_sample(labeled, "train-000000")
    assert sample.token_light.shape == (sample.triangles.num_objects, 8, 3, 3)
    split = ShardSplit(labeled, "train")
    batch = RaggedBatch.pack([AllViews(split, ("albedo",))[index] for index in range(2)])
    first = sample.triangles.num_objects * 8
    np.testing.assert_array_equal(batch.token_light[:first].numpy(), sample.token_light.reshape(first, 3, 3))
    padded = batch.padded()
    assert len(padded.token_light) == 8 * len(padded.objects)
    assert padded.token_light[len(batch.token_light) :].isnan().all()


def test_light_of_another_number_of_objects_is_refused(labeled):
    sample = find_sample(labeled, "train-000000")
    damaged = dataclasses.replace(sample, token_light=sample.token_light[:-1])
    with pytest.raises(ShardError, match="token_light has the shape"):
        decode(sample.key, encode(damaged))
