import numpy as np
import pytest
from scene_families import family
from scipy.stats import kstest, spearmanr

SAMPLER = family("small_scale").materials


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(0)
    return [SAMPLER.sample(rng) for _ in range(4000)]


@pytest.fixture(scope="module")
def columns(drawn):
    return {
        "diffuse": np.array([m.diffuse for m in drawn]),
        "specular": np.array([m.specular[0] for m in drawn]),
        "roughness": np.array([m.roughness for m in drawn]),
        "smooth": np.array([m.smooth_shading for m in drawn]),
    }


def test_no_material_reflects_more_than_it_receives_or_emits(drawn):
    for material in drawn:
        assert max(d + s for d, s in zip(material.diffuse, material.specular, strict=True)) <= 1
        assert len(set(material.specular)) == 1
        assert not material.is_emissive


def test_specular_is_a_uniform_share_of_a_sum_near_one(columns):
    # specular = share · sum with the sum in [0.9, 1.0]: its quantiles are those of U[0, 1] times 0.95, within 0.05.
    quantiles = np.quantile(columns["specular"], [0.1, 0.5, 0.9])
    assert quantiles == pytest.approx([0.095, 0.475, 0.855], abs=0.025)
    assert columns["specular"].max() > 0.95


def test_diffuse_color_is_uniform_below_what_specular_leaves(columns):
    share = columns["diffuse"] / (0.95 - np.minimum(columns["specular"], 0.85))[:, None]
    matte = columns["specular"] < 0.5
    for channel in share[matte].T:
        assert kstest(channel, "uniform").statistic < 0.05


def test_roughness_is_log_uniform_in_its_shifted_value(columns):
    roughness = columns["roughness"]
    assert roughness.min() >= 0.01
    assert roughness.max() <= 1
    uniform = (np.log(roughness + 0.05) - np.log(0.06)) / (np.log(1.05) - np.log(0.06))
    assert kstest(uniform, "uniform").pvalue > 0.01
    assert kstest(roughness, "uniform").pvalue < 1e-6  # the check can fail


def test_half_are_smooth(columns):
    assert columns["smooth"].mean() == pytest.approx(0.5, abs=0.03)


def test_quantities_are_independent(columns):
    hue = columns["diffuse"] / columns["diffuse"].max(axis=1, keepdims=True)  # without the split's brightness
    others = np.stack([columns["specular"], columns["roughness"], columns["smooth"]], axis=1)
    correlation = np.abs(spearmanr(np.concatenate([hue, others], axis=1)).statistic)
    bound = 4.5 / np.sqrt(len(hue))
    assert correlation[:3, 3:].max() < bound
    assert correlation[3:, 3:][~np.eye(3, dtype=bool)].max() < bound
