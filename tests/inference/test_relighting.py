"""Lights from pictures: known factors are recovered, and ambiguous ones are reported."""

import numpy as np
import pytest
from edited_scenes import scene
from networks import checkpoint_info

from rfpp import Renderer
from rfpp.inference.relighting import solve_lights, with_factors
from rfpp.radiosity.radiosity import Radiosity

EVERYWHERE = np.ones((2, 8, 8), bool)


@pytest.fixture
def layers():
    rng = np.random.default_rng(0)
    return {name: rng.exponential(size=(2, 8, 8, 3)).astype(np.float32) for name in ("key", "fill", "rim")}


def mixed(layers, **factors):
    return sum(np.asarray(factors[name], np.float32) * image for name, image in layers.items())


def test_power_and_color_of_each_light_are_recovered(layers):
    true = {"key": [0.5, 1.0, 2.0], "fill": [3.0, 0.2, 0.0], "rim": [1.0, 1.0, 1.0]}
    solved = solve_lights(layers, mixed(layers, **true), EVERYWHERE)
    for name, factor in true.items():
        np.testing.assert_allclose(solved.factors[name], factor, atol=2e-3)
    assert solved.before > 0.1 and solved.after < 1e-3
    np.testing.assert_allclose(solved.images, mixed(layers, **solved.factors), rtol=1e-5)


def test_factors_are_never_negative(layers):
    darker = mixed(layers, key=1.0, fill=-0.5, rim=1.0).clip(0)
    factors = solve_lights(layers, darker, EVERYWHERE).factors
    assert all((factor >= 0).all() for factor in factors.values())
    np.testing.assert_array_equal(factors["fill"], 0)


def test_displaced_highlights_do_not_matter(layers):
    """Lights in a mirror: bright in some pixels of the target, and in other pixels of a light's image."""
    target, rng = mixed(layers, key=2.0, fill=0.5, rim=1.0), np.random.default_rng(1)
    target[rng.random(EVERYWHERE.shape) < 0.05] = 300
    layers["fill"][rng.random(EVERYWHERE.shape) < 0.01] = 30
    factors = solve_lights(layers, target, EVERYWHERE).factors
    for name, factor in {"key": 2.0, "fill": 0.5, "rim": 1.0}.items():
        np.testing.assert_allclose(factors[name], factor, atol=0.05)


def test_invisible_lights_keep_their_values(layers):
    layers["fill"][:] = 0
    solved = solve_lights(layers, mixed(layers, key=2.0, fill=7.0, rim=1.0), EVERYWHERE)
    assert solved.invisible == ("fill",)
    np.testing.assert_array_equal(solved.factors["fill"], 1)


def test_indistinguishable_lights_are_reported(layers):
    layers["rim"] = 2 * layers["key"]
    solved = solve_lights(layers, mixed(layers, key=1.0, fill=1.0, rim=2.0), EVERYWHERE)
    assert solved.alike == (("key", "rim"),)
    assert solved.after < 1e-2
    np.testing.assert_allclose(solved.factors["key"] + 2 * solved.factors["rim"], 5.0, rtol=1e-2)


def test_a_scene_with_factors_looks_like_the_mixture():
    renderer = Renderer(Radiosity(), checkpoint_info(resolution=(16, 16)))
    factors = {"lamp": np.array([0.5, 1.0, 2.0]), "spot": np.array([2.0, 2.0, 0.0])}
    layers = renderer.render_lights(scene(), light_samples=4)
    rendered = renderer.render(with_factors(scene(), factors), light_samples=4)
    np.testing.assert_allclose(rendered, mixed(layers, **factors), rtol=1e-3, atol=1e-5)
