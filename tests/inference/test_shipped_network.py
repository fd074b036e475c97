"""The included RenderFormer++, `rfpp-tiny`: small, and better than what needs no network."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scene_families import draw, family

from rfpp import Renderer
from rfpp.inference.plan import Plan
from rfpp.inference.radiosity_engine import RadiosityEngine
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.radiosity.radiosity import Radiosity
from rfpp.raycast.first_hit import stack_channels
from rfpp.scene.packed import pack
from rfpp.shards.scene_rays import SceneRays


def log_error(image: np.ndarray, reference: np.ndarray) -> float:
    return float(np.abs(np.log10(1 + image) - np.log10(1 + reference)).mean())


def albedo_times_constant(scene, reference: np.ndarray) -> np.ndarray:
    """The best such image of this very view."""
    rays = SceneRays(scene.triangles)
    gbuffer = rays.first_hit(scene.c2w[0], scene.fov[0], 64)
    albedo = stack_channels(gbuffer, scene.triangles.material, float(scene.fov[0]), ("albedo", "specular"))
    both = (albedo[:3] + albedo[3:]).transpose(1, 2, 0)
    return min((factor * both for factor in np.geomspace(0.02, 3, 60)), key=lambda image: log_error(image, reference))


@pytest.fixture(scope="module")
def scenes():
    """Scenes that it was not trained on, with their first view by radiosity."""
    source, found = family("quickstart"), []
    for seed in range(6):
        scene = pack(draw(source, 900 + seed, seed, held_out=True)).views([0])
        engine = RadiosityEngine(Radiosity(), torch.device("cpu"), torch.float32)
        found.append((scene, next(iter(engine.views(Plan(scene, (64, 64), 8, 2))))))
    return found


def test_it_is_the_papers_network_without_known_light():
    network = Renderer.load("rfpp-tiny").engine.module
    assert isinstance(network, RenderFormerPP)
    assert network.iterations == 3 and network.gbuffer_channels == ("albedo", "normal", "roughness")


def test_it_beats_the_best_constant_times_albedo_in_unseen_scenes(scenes):
    renderer = Renderer.load("rfpp-tiny")
    errors = [log_error(renderer.render(scene, resolution=64)[0], reference) for scene, reference in scenes]
    trivial = [log_error(albedo_times_constant(scene, reference), reference) for scene, reference in scenes]
    assert np.mean(errors) < 0.85 * np.mean(trivial)


def test_twice_the_light_is_twice_the_image(scenes):
    """Scenes are normalized to the exposure of their lights."""
    scene, _ = scenes[0]
    material = scene.triangles.material.copy()
    material[:, 7:] *= 2
    brighter = replace(scene, triangles=replace(scene.triangles, material=material))
    renderer = Renderer.load("rfpp-tiny", precision="fp32")
    once = renderer.render(scene, resolution=64)[0]
    twice = renderer.render(brighter, resolution=64)[0]
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-3, atol=1e-4)
