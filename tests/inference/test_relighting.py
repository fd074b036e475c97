"""Lights from pictures: what was changed is found again, and what cannot be known is said."""

import numpy as np
import pytest
from edited_scenes import scene
from networks import checkpoint_info

from rfpp import Renderer
from rfpp.inference.relighting import solve_lights, with_factors
from rfpp.radiosity.radiosity import Radiosity
from rfpp.scene.packed import pack

EVERYWHERE = np.ones((2, 8, 8), bool)


@pytest.fixture
def layers():
    rng = np.random.default_rng(0)
    return {name: rng.exponential(size=(2, 8, 8, 3)).astype(np.float32) for name in ("key", "fill", "rim")}


def mixed(layers, **factors):
    return sum(np.asarray(factors[name], np.float32) * image for name, image in layers.items())


def test_power_and_colour_of_each_light_are_found(layers):
    truth = {"key": [0.5, 1.0, 2.0], "fill": [3.0, 0.2, 0.0], "rim": [1.0, 1.0, 1.0]}
    solved = solve_lights(layers, mixed(layers, **truth), EVERYWHERE, pull=0.0)
    for name, factor in truth.items():
        np.testing.assert_allclose(solved.factors[name], factor, atol=1e-4)
    assert solved.before > 0.1 and solved.after < 1e-4
    np.testing.assert_allclose(solved.images, mixed(layers, **truth), rtol=1e-3, atol=1e-4)


def test_without_colours_each_light_has_one_factor(layers):
    solved = solve_lights(layers, mixed(layers, key=0.5, fill=2.0, rim=1.5), EVERYWHERE, colours=False, pull=0.0)
    for name, factor in {"key": 0.5, "fill": 2.0, "rim": 1.5}.items():
        np.testing.assert_allclose(solved.factors[name], [factor] * 3, atol=1e-4)


def test_no_light_takes_light_away(layers):
    darker = mixed(layers, key=1.0, fill=-0.5, rim=1.0).clip(0)
    factors = solve_lights(layers, darker, EVERYWHERE, pull=0.0).factors
    assert all((factor >= 0).all() for factor in factors.values())
    np.testing.assert_array_equal(factors["fill"], 0)


def test_highlights_that_stand_elsewhere_turn_nothing(layers):
    """Lamps in a mirror: bright in some pixels of the target, and in others of one light's image."""
    target, rng = mixed(layers, key=2.0, fill=0.5, rim=1.0), np.random.default_rng(1)
    target[rng.random(EVERYWHERE.shape) < 0.05] = 300
    layers["fill"][rng.random(EVERYWHERE.shape) < 0.01] = 30
    factors = solve_lights(layers, target, EVERYWHERE, pull=0.0).factors
    for name, factor in {"key": 2.0, "fill": 0.5, "rim": 1.0}.items():
        np.testing.assert_allclose(factors[name], factor, atol=0.05)


def test_what_does_not_count_is_not_looked_at(layers):
    target, counts = mixed(layers, key=2.0, fill=1.0, rim=1.0), EVERYWHERE.copy()
    target[:, :3], counts[:, :3] = np.nan, False
    solved = solve_lights(layers, target, counts, pull=0.0)
    np.testing.assert_allclose(solved.factors["key"], 2.0, atol=1e-4)


def test_a_light_that_is_not_seen_stays_and_is_named(layers):
    layers["fill"][:] = 0
    solved = solve_lights(layers, mixed(layers, key=2.0, fill=7.0, rim=1.0), EVERYWHERE)
    assert solved.unseen == ("fill",)
    np.testing.assert_array_equal(solved.factors["fill"], 1)


def test_lights_that_cannot_be_told_apart_are_named_and_share_what_is_known(layers):
    layers["rim"] = 2 * layers["key"]
    solved = solve_lights(layers, mixed(layers, key=1.0, fill=1.0, rim=2.0), EVERYWHERE)
    assert solved.alike == (("key", "rim"),)
    assert solved.after < 1e-2
    np.testing.assert_allclose(solved.factors["key"] + 2 * solved.factors["rim"], 5.0, rtol=1e-2)


@pytest.mark.parametrize("form", [scene, lambda: pack(scene())], ids=["scene", "packed"])
def test_a_scene_with_the_factors_looks_like_the_sum_with_the_factors(form):
    renderer = Renderer(Radiosity(), checkpoint_info(resolution=(16, 16)))
    factors = {"lamp": np.array([0.5, 1.0, 2.0]), "spot": np.array([2.0, 2.0, 0.0])}
    apart = renderer.render_lights(form(), light_samples=4)
    np.testing.assert_allclose(
        renderer.render(with_factors(form(), factors), light_samples=4), mixed(apart, **factors), rtol=1e-3, atol=1e-5
    )
