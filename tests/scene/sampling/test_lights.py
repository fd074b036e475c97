from itertools import combinations

import numpy as np
import pytest
from scene_families import family

from rfpp.scene.sampling.lights import triangle_mesh

FAMILY = family("large_scale")


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(0)
    backgrounds = [FAMILY.backgrounds.sample(rng) for _ in range(400)]
    return [(b, FAMILY.lights.sample(rng, b.open_region)) for b in backgrounds]


def test_each_light_is_the_published_triangle(drawn):
    assert np.array_equal(
        np.sort(triangle_mesh().vertices, axis=0), np.float32([[-0.025] * 3, [0.025] * 3, [0.025] * 3])
    )
    for _, lights in drawn:
        for light in lights:
            assert len(light.mesh) == 1
            assert not light.transform.normalize
            assert all(2 <= s <= 2.5 for s in light.transform.scale)
            assert np.abs(light.transform.rotation).max() <= 180
            assert light.material.diffuse == (1, 1, 1)
            assert light.material.specular == (0, 0, 0)


def test_the_strengths_add_up_to_one_light(drawn):
    for _, lights in drawn:
        emitted = np.array([light.material.emissive for light in lights])
        assert (emitted == emitted[:, :1]).all()  # white
        assert 2500 - 1e-6 <= emitted[:, 0].sum() <= 5000 + 1e-6
        assert (emitted * len(lights) >= 2500 - 1e-6).all()
        assert (emitted * len(lights) <= 5000 + 1e-6).all()


def test_lights_are_apart_and_at_the_published_distance(drawn):
    for _, lights in drawn:
        positions = np.array([light.transform.translation for light in lights])
        for a, b in combinations(positions, 2):
            assert np.linalg.norm(a - b) > 0.3
        # The target is within ±0.2 per axis of the center.
        distance = np.linalg.norm(positions, axis=1)
        assert (distance >= 2.1 - 0.2 * 3**0.5).all()
        assert (distance <= 2.7 + 0.2 * 3**0.5).all()


def test_every_corner_of_a_light_is_in_front_of_the_background(drawn):
    for background, lights in drawn:
        for light in lights:
            reach = 2.5 * np.linalg.norm(light.mesh.vertices, axis=1).max()
            assert background.open_region.distances(np.array(light.transform.translation)).min() > reach
