"""The glossy lobe against numeric integration over the hemisphere."""

import numpy as np
import pytest
from slow_light import lobes, multiple_scattering, samples_of

_ROUGHNESS = [0.3, 0.6, 1.0]
_COSINES = [0.2, 0.7, 1.0]


def hemisphere(count: int) -> tuple[np.ndarray, float]:
    """Evenly spread directions [count², 3] and the solid angle of each."""
    z = (np.arange(count) + 0.5) / count
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    z, angle = (a.ravel() for a in np.meshgrid(z, angle))
    level = np.sqrt(1 - z**2)
    return np.stack([level * np.cos(angle), level * np.sin(angle), z], axis=-1), 2 * np.pi / count**2


def view_at(cosine: float, count: int) -> np.ndarray:
    return np.tile([np.sqrt(1 - cosine**2), 0, cosine], (count, 1))


@pytest.mark.parametrize("roughness", _ROUGHNESS)
@pytest.mark.parametrize("cosine", _COSINES)
def test_samples_follow_their_density(roughness, cosine):
    alpha, count = roughness**2, 400
    directions, solid = hemisphere(count)
    _, density = lobes(view_at(cosine, 1), directions, alpha)
    random = np.random.default_rng(0).random((40000, 2))
    drawn = samples_of(view_at(cosine, 1), alpha, *random.T)
    up = drawn[:, 2] > 0
    assert density.sum() * solid == pytest.approx(up.mean(), abs=0.01)
    expected = (density[:, None] * directions).sum(0) * solid
    np.testing.assert_allclose((drawn * up[:, None]).mean(0), expected, atol=0.01)


@pytest.mark.parametrize("roughness", _ROUGHNESS)
@pytest.mark.parametrize("cosine", _COSINES)
def test_a_white_lobe_returns_all_the_light_it_gets(roughness, cosine):
    directions, solid = hemisphere(600)
    single = lobes(view_at(cosine, 1), directions, roughness**2)[0].sum() * solid
    gain = multiple_scattering(cosine, roughness**2, 1.0)
    assert single < 1
    np.testing.assert_allclose(single * gain, 1, atol=0.01)


def test_the_lobe_is_reciprocal_and_dark_from_below():
    rng = np.random.default_rng(1)
    a, b = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in rng.normal((0, 0, 1), size=(2, 200, 3)))
    alpha = rng.uniform(0.05, 1, 200)
    both = (a[:, 2] > 0) & (b[:, 2] > 0)
    assert 0 < both.sum() < 200
    (forth, density), (back, _) = lobes(a, b, alpha), lobes(b, a, alpha)
    np.testing.assert_allclose((forth / b[:, 2])[both], (back / a[:, 2])[both], rtol=1e-9)
    assert not forth[~both].any() and not density[~both].any()


def test_darker_tints_lose_light_at_every_further_bounce():
    gain = multiple_scattering(0.5, 0.8, np.array([0.0, 0.5, 1.0]))
    assert gain[0] == pytest.approx(1)
    assert gain[0] < gain[1] < gain[2]


@pytest.mark.parametrize(("cosine", "alpha"), [(np.nan, 0.5), (0.5, np.nan), (np.inf, 0.5), (-1e30, 0.5)])
def test_what_is_no_number_reads_nothing_beyond_the_table(cosine, alpha):
    """Compiled loops check no bounds."""
    many = np.full(1000, 1.0)
    scale = multiple_scattering(cosine, alpha, 0.5 * many)
    assert np.isnan(scale).all() or ((scale >= 1) & (scale < 3)).all()
