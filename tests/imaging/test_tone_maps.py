"""Tone maps: monotonic, exposed in stops, and defined for broken pixels; AgX by its definition."""

import numpy as np
import pytest
import torch

from rfpp.errors import UserError
from rfpp.imaging.radiance import srgb
from rfpp.imaging.tone_maps import SRGB, AgX, Neutral, Perceptual, tone_map_of

ALL = (SRGB, Perceptual, Neutral, AgX)


def grays(*values: float) -> np.ndarray:
    return np.repeat(np.array([values], np.float32)[..., None], 3, axis=-1)


def color(*rgb: float) -> torch.Tensor:
    return torch.tensor([[rgb]], dtype=torch.float32)


@pytest.mark.parametrize("kind", ALL)
def test_tone_maps_are_monotonic_from_black_to_white(kind):
    picture = kind()(grays(*np.geomspace(1e-4, 1e4, 2000)))[0].astype(int)
    assert (np.diff(picture, axis=0) >= 0).all()
    assert picture[-1].tolist() == [255] * 3
    assert (picture == picture[:, :1]).all(), "gray stays gray"
    assert kind()(grays(0.0)).tolist() == [[[0, 0, 0]]]


@pytest.mark.parametrize("kind", ALL)
def test_a_stop_doubles_the_radiance(kind):
    image = np.random.default_rng(0).lognormal(-2, 1, (8, 9, 3)).astype(np.float32)
    brighter = kind(stops=1.0)(image)
    np.testing.assert_array_equal(brighter, kind()(2 * image))
    assert brighter.mean() > kind()(image).mean()
    np.testing.assert_array_equal(kind(stops=-3)(8 * image), kind()(image))


@pytest.mark.parametrize("kind", ALL)
def test_any_memory_layout_and_broken_pixels(kind):
    image = np.random.default_rng(1).random((5, 4, 3))
    np.testing.assert_array_equal(kind()(image.transpose(1, 0, 2)), kind()(image).transpose(1, 0, 2))
    image[2, 2], image[3, 3], image[4, 1] = np.nan, np.inf, -0.1
    assert [kind()(image)[place].tolist() for place in ((2, 2), (3, 3), (4, 1))] == [[0] * 3, [255] * 3, [0] * 3]
    assert kind()(image)[0, 0].any()


def test_neutral_keeps_colors_below_its_threshold_but_for_the_reflection_it_subtracts():
    kept = torch.rand((20, 20, 3), generator=torch.Generator().manual_seed(0)) * 0.72 + 0.08
    torch.testing.assert_close(Neutral().display(kept), srgb(kept - 0.04))


def test_neutral_is_smooth_where_compression_begins_and_keeps_hue_beyond():
    below, above = (Neutral().display(color(x, x, x)) for x in (0.79999, 0.80001))
    torch.testing.assert_close(below, above, atol=1e-4, rtol=0)
    red, green, blue = Neutral().display(color(6.0, 2.0, 1.0)).flatten().tolist()
    assert 1 > red > green > blue > 0
    assert Neutral().display(color(600.0, 2.0, 1.0)).min() > 0.9, "very bright colors become white"


def test_agx_maps_middle_gray_to_half_and_its_range_to_the_full_signal():
    assert AgX()(grays(0.18))[0, 0, 0] in (127, 128)
    assert AgX()(grays(0.18 * 2.0**-10.5, 0.18 * 2.0**6.5))[0, :, 0].tolist() == [0, 255]
    inside = AgX().display(torch.from_numpy(grays(0.18 * 2.0**-9, 0.18 * 2.0**6)))[0, :, 0]
    assert 0 < inside[0] < 0.01 and 0.99 < inside[1] < 1


def test_agx_has_slope_two_at_middle_gray():
    """Along the logarithmic axis of 16.5 stops, in display signal."""
    step = 0.01
    low, high = AgX().display(torch.from_numpy(grays(0.18 * 2**-step, 0.18 * 2**step)))[0, :, 0]
    from_srgb = [((x + 0.055) / 1.055) ** 2.4 for x in (low.item(), high.item())]
    low, high = (x ** (1 / 2.2) for x in from_srgb)
    assert (high - low) / (2 * step / 16.5) == pytest.approx(2, rel=1e-2)


def test_agx_fades_bright_colors_to_white():
    def saturation(picture):
        return 1 - picture.min().item() / picture.max().item()

    dark, bright, glaring = (saturation(AgX().display(color(4 * x, x, x))) for x in (0.02, 0.5, 8.0))
    assert dark > bright > glaring
    assert dark > 0.3


@pytest.mark.parametrize("kind", ALL)
def test_each_has_a_name(kind):
    assert type(tone_map_of(kind.__name__.lower(), stops=-1.5)) is kind


def test_an_unknown_name_is_one_clear_error():
    with pytest.raises(UserError, match="tone_map=filmic does not exist: choose from srgb, perceptual, neutral, agx"):
        tone_map_of("filmic", stops=0)
