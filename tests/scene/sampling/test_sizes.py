import numpy as np
import pytest
from scene_families import family
from scipy.stats import kstest

from rfpp.scene.sampling.sizes import SharedSpace, UniformRadius


@pytest.mark.parametrize("count", [3, 70])
def test_shared_radii_are_log_normal_around_the_radius_that_fills_the_share(count):
    rng = np.random.default_rng(0)
    sampler = SharedSpace(fill=(0.2, 0.2), spread=0.35, max_radius=10.0)
    radii = np.concatenate([sampler.sample(rng, count) for _ in range(2100 // count)])
    base = (3 * 0.2 / (4 * np.pi * count)) ** (1 / 3)
    assert count * 4 / 3 * np.pi * base**3 == pytest.approx(0.2)
    assert kstest(np.log(radii / base) / 0.35, "norm").pvalue > 0.01


def test_the_share_is_drawn_once_a_scene_and_uniform():
    rng = np.random.default_rng(0)
    sampler = SharedSpace(fill=(0.1, 0.3), spread=0.0, max_radius=10.0)
    radii = np.array([sampler.sample(rng, 20) for _ in range(1000)])
    assert (radii == radii[:, :1]).all()
    fill = 20 * 4 / 3 * np.pi * radii[:, 0] ** 3
    assert kstest((fill - 0.1) / 0.2, "uniform").pvalue > 0.01


def test_renderformers_radii_are_its_published_ones_whatever_the_number_of_objects():
    sizes = family("renderformer").placement.sizes
    assert sizes == UniformRadius((0.2, 0.45))
    rng = np.random.default_rng(0)
    radii = np.concatenate([sizes.sample(rng, 1 + i % 3) for i in range(1000)])
    assert kstest((radii - 0.2) / 0.25, "uniform").pvalue > 0.01
