import numpy as np
import pytest

from rfpp.metrics.flip import flip


@pytest.fixture
def reference():
    return np.random.default_rng(0).lognormal(-1, 1, (24, 32, 3)).astype(np.float32)


def test_equal_images_have_none_and_larger_differences_more(reference):
    assert flip(reference, reference).max() == 0
    slight, strong = flip(1.1 * reference, reference), flip(2 * reference, reference)
    assert slight.shape == (24, 32)
    assert 0 < slight.mean() < strong.mean() < 1


def test_an_error_is_seen_where_it_is(reference):
    wrong = reference.copy()
    wrong[:, 16:] *= 0.5
    error = flip(wrong, reference)
    assert error[:, :4].max() < 0.05 < error[:, 20:].mean()


@pytest.mark.parametrize("level", [0.0, 0.5])
def test_a_reference_of_one_brightness_has_an_error_too(level, reference):
    """The library ends the process where it finds no exposure of its own."""
    flat = np.full_like(reference, level)
    assert flip(flat, flat).max() == 0
    assert flip(reference, flat).mean() > 0.05


def test_broken_pixels_are_wholly_wrong(reference):
    broken = reference.copy()
    broken[3, 4, 1], broken[5, 6] = np.nan, np.inf
    error = flip(broken, reference)
    assert error[3, 4] == error[5, 6] == 1
    assert np.isfinite(error).all()
