"""Compiled loops against their slow twins, and the random numbers that they draw."""

import numpy as np
import pytest
from known_scenes import look_at, material, pack, sphere, square, still_life
from slow_light import cell_keys, direct_light

from rfpp.radiosity.cell_grid import CellGrid
from rfpp.raycast.counted_random import key_of, spread, uniform
from rfpp.raycast.direct_light import gathered
from rfpp.raycast.first_hit import first_hit
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.surface import Surface

POSE, FOV, SIDE = look_at((0.3, -1.5, 0.9), (0, 0, 0.1)), 40.0, 16


@pytest.mark.parametrize("triangles_of_lamp", [1, 80])
def test_direct_light_is_that_of_the_twin(triangles_of_lamp):
    """Of few triangles by Lambert's formula, of many by samples alone."""
    place = np.array([0.3, -0.4, 1.2])
    lamp = (square(0.4) + place)[:1] if triangles_of_lamp == 1 else sphere(0.2, place, 1)
    assert len(lamp) == triangles_of_lamp
    things = (square(), material(0.4, specular=0.5, roughness=0.5)), (sphere(0.2, (0, 0, 0.3)), material(0.6))
    scene = pack(*things, (lamp, material(emission=8.0)))
    gbuffer = first_hit(scene, POSE, FOV, SIDE, SIDE)
    surface, sampler = Surface.at_hits(gbuffer, scene, POSE, FOV), LightSampler(scene)
    twin = direct_light(scene, surface, 1024 // triangles_of_lamp, np.random.default_rng(0))
    twin[1, ~(surface.specular > 0).any(-1)] = 0
    of_image = with_known_light(gbuffer, POSE, FOV, sampler, 256).light
    anywhere = gathered(sampler, surface, 256, np.random.default_rng(1))
    for ours in (np.stack([of_image.diffuse, of_image.glossy])[:, gbuffer.hit], anywhere):
        error = np.abs(ours - twin).mean((1, 2)) / twin.mean((1, 2))
        assert error[0] < 0.02 and error[1] < 0.04
        np.testing.assert_allclose(ours.mean((1, 2)), twin.mean((1, 2)), rtol=0.01)


def test_a_light_that_does_not_shine_still_casts_its_shadow():
    scene = still_life()
    gbuffer, sampler = first_hit(scene, POSE, FOV, 32, 32), LightSampler(scene)
    whole = with_known_light(gbuffer, POSE, FOV, sampler, 8)
    parts = [with_known_light(gbuffer, POSE, FOV, sampler.only(name), 8) for name in sampler.names]
    assert len(parts) == 2
    for light, lobe in (("light", "diffuse"), ("light", "glossy"), ("reflection", "light")):
        added = sum(getattr(getattr(part, light), lobe) for part in parts)
        np.testing.assert_allclose(added, getattr(getattr(whole, light), lobe), rtol=1e-3, atol=1e-5)


def test_keys_of_cells_are_those_of_the_twin():
    scene, rng = still_life(), np.random.default_rng(0)
    grid, count = CellGrid.over(scene), 2000
    triangle, back = rng.integers(len(scene), size=count), rng.random(count) < 0.5
    weights = rng.dirichlet([1, 1, 1], count)
    point = np.einsum("rk,rkx->rx", weights, scene.positions[triangle].astype(np.float64))
    np.testing.assert_array_equal(grid.keys(triangle, point, back), cell_keys(grid, triangle, point, back))


def test_numbers_by_number_are_uniform_and_independent_of_their_neighbors():
    drawn = np.array([[uniform(np.uint64(key_of(7, row)), column) for column in range(4)] for row in range(4000)])
    assert drawn.min() >= 0 and drawn.max() < 1
    counts = np.histogram(drawn, 16, (0, 1))[0] / drawn.size
    np.testing.assert_allclose(counts, 1 / 16, rtol=0.1)
    correlation = np.corrcoef(np.column_stack([drawn[:-1], drawn[1:]]).T)
    assert np.abs(correlation - np.eye(8)).max() < 0.06


@pytest.mark.parametrize("count", [4, 16, 64])
def test_any_first_few_points_are_spread_evenly(count):
    points = np.array([spread(number, 0.3, 0.8) for number in range(count)])
    apart = np.abs(points[:, None] - points)
    apart = np.minimum(apart, 1 - apart)
    nearest = np.linalg.norm(apart + 2 * np.eye(count)[..., None], axis=-1).min()
    assert nearest > 0.5 / np.sqrt(count)
