"""References light by light: their sum is the image, and mixtures are images of scenes whose lights were changed."""

from dataclasses import replace

import numpy as np
import pytest
from known_scenes import look_at, still_life
from marks import requires_blender
from reference_presets import preset

from rfpp.reference.cycles import CyclesSettings, render, render_lights
from rfpp.scene.triangles import EMISSION, SceneTriangles

pytestmark = requires_blender

SETTINGS = CyclesSettings(**preset("unclamped") | {"samples": 128, "denoise": False, "threads": 1})
VIEW = (look_at((0.3, -1.2, 0.9))[None].astype(np.float32), np.full(1, 40, np.float32), 24, 24)
#: Scales of each light's red, green and blue.
FACTORS = np.array([[0.2, 0.5, 1.0], [3.0, 1.0, 2.0]], np.float32)


def with_lights(factors: np.ndarray) -> SceneTriangles:
    scene = still_life()
    material = scene.material.copy()
    material[scene.is_emissive, EMISSION] *= factors
    return replace(scene, material=material)


@pytest.fixture
def layers(in_process):
    return in_process(render_lights, still_life(), *VIEW, SETTINGS)


def error(image, truth) -> float:
    return float(np.abs(image - truth).mean() / truth.mean())


def test_layers_add_up_to_images_but_for_noise(in_process, layers):
    assert layers.shape == (2, 1, 24, 24, 3)
    assert layers.mean((1, 2, 3, 4)).min() > 0.02
    for factors in (np.ones_like(FACTORS), FACTORS):
        scene = with_lights(factors)
        image, other = (in_process(render, scene, *VIEW, replace(SETTINGS, seed=seed)) for seed in (5, 6))
        noise = error(other, image)
        assert 0 < noise < 0.1
        mixture = np.einsum("lvhwc,lc->vhwc", layers, factors)
        assert error(mixture, image) < 1.2 * noise
        assert mixture.mean((0, 1, 2)) == pytest.approx(image.mean((0, 1, 2)), rel=0.02)


def test_one_layer_is_the_scene_with_the_other_light_dimmed(in_process, layers):
    for number, layer in enumerate(layers):
        factors = np.full_like(FACTORS, 1e-7)
        factors[number] = 1
        alone = in_process(render, with_lights(factors), *VIEW, SETTINGS)
        assert error(layer, alone) < 0.1
        assert layer.mean() == pytest.approx(alone.mean(), rel=0.02)


def test_lights_have_noise_of_their_own(in_process):
    """Of two lights at one place, the same noise would be twice as bright in their sum."""
    scene = still_life()
    first, second = (np.flatnonzero(scene.is_emissive)[i] for i in (0, 1))
    positions = scene.positions.copy()
    positions[second] = positions[first]
    bounces = dict.fromkeys(("max_bounces", "diffuse_bounces", "glossy_bounces"), 0)  # which would bring fireflies
    direct = replace(SETTINGS, samples=64, **bounces)
    one, two = in_process(render_lights, replace(scene, positions=positions), *VIEW, direct)
    assert not np.array_equal(one, two)
    assert one.mean() == pytest.approx(two.mean(), rel=0.1)
