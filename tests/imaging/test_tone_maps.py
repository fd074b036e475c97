"""Tone maps: what they keep, what they send where, and what they refuse."""

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from rfpp.commands import CONFIG_DIR
from rfpp.imaging.radiance import srgb
from rfpp.imaging.tone_maps import SRGB, AgX, Neutral, Perceptual

ALL = (SRGB, Perceptual, Neutral, AgX)


def greys(*values: float) -> np.ndarray:
    return np.repeat(np.array([values], np.float32)[..., None], 3, axis=-1)


def colour(*rgb: float) -> torch.Tensor:
    return torch.tensor([[rgb]], dtype=torch.float32)


@pytest.mark.parametrize("kind", ALL)
def test_more_light_is_never_shown_darker_and_black_stays_black(kind):
    shown = kind()(greys(*np.geomspace(1e-4, 1e4, 2000)))[0].astype(int)
    assert (np.diff(shown, axis=0) >= 0).all()
    assert shown[-1].tolist() == [255] * 3
    assert (shown == shown[:, :1]).all(), "grey stays grey"
    assert kind()(greys(0.0)).tolist() == [[[0, 0, 0]]]


@pytest.mark.parametrize("kind", ALL)
def test_a_stop_doubles_the_radiance(kind):
    image = np.random.default_rng(0).lognormal(-2, 1, (8, 9, 3)).astype(np.float32)
    brighter = kind(stops=1.0)(image)
    np.testing.assert_array_equal(brighter, kind()(2 * image))
    assert brighter.mean() > kind()(image).mean()
    np.testing.assert_array_equal(kind(stops=-3)(8 * image), kind()(image))


@pytest.mark.parametrize("kind", ALL)
def test_pictures_of_any_layout_and_of_broken_pixels(kind):
    image = np.random.default_rng(1).random((5, 4, 3))
    np.testing.assert_array_equal(kind()(image.transpose(1, 0, 2)), kind()(image).transpose(1, 0, 2))
    image[2, 2], image[3, 3], image[4, 1] = np.nan, np.inf, -0.1
    assert [kind()(image)[place].tolist() for place in ((2, 2), (3, 3), (4, 1))] == [[0] * 3, [255] * 3, [0] * 3]
    assert kind()(image)[0, 0].any()


def test_perceptual_is_the_metrics_tone_map():
    assert Perceptual()(greys(2**0.5 - 1, 1.0, 5.0))[0, :, 0].tolist() == [128, 255, 255]


def test_neutral_keeps_colours_below_its_threshold_up_to_the_reflection_it_takes_off():
    kept = torch.rand((20, 20, 3), generator=torch.Generator().manual_seed(0)) * 0.72 + 0.08
    torch.testing.assert_close(Neutral().display(kept), srgb(kept - 0.04))


def test_neutral_is_smooth_where_compression_begins_and_keeps_hue_beyond():
    below, above = (Neutral().display(colour(x, x, x)) for x in (0.79999, 0.80001))
    torch.testing.assert_close(below, above, atol=1e-4, rtol=0)
    red, green, blue = Neutral().display(colour(6.0, 2.0, 1.0)).flatten().tolist()
    assert 1 > red > green > blue > 0
    assert Neutral().display(colour(600.0, 2.0, 1.0)).min() > 0.9, "very bright colours become white"


def test_agx_sends_middle_grey_to_half_the_signal_and_its_range_to_all_of_it():
    assert AgX()(greys(0.18))[0, 0, 0] in (127, 128)
    assert AgX()(greys(0.18 * 2.0**-10.5, 0.18 * 2.0**6.5))[0, :, 0].tolist() == [0, 255]
    inside = AgX().display(torch.from_numpy(greys(0.18 * 2.0**-9, 0.18 * 2.0**6)))[0, :, 0]
    assert 0 < inside[0] < 0.01 and 0.99 < inside[1] < 1


def test_agx_has_slope_two_at_middle_grey():
    """Along its logarithmic axis of 16.5 stops, in display signal."""
    step = 0.01
    low, high = AgX().display(torch.from_numpy(greys(0.18 * 2**-step, 0.18 * 2**step)))[0, :, 0]
    from_srgb = [((x + 0.055) / 1.055) ** 2.4 for x in (low.item(), high.item())]
    low, high = (x ** (1 / 2.2) for x in from_srgb)
    assert (high - low) / (2 * step / 16.5) == pytest.approx(2, rel=1e-2)


def test_agx_pales_bright_colours_and_keeps_dull_ones():
    def saturation(shown):
        return 1 - shown.min().item() / shown.max().item()

    dull, bright, glaring = (saturation(AgX().display(colour(4 * x, x, x))) for x in (0.02, 0.5, 8.0))
    assert dull > bright > glaring
    assert dull > 0.3


@pytest.mark.parametrize("kind", ALL)
def test_each_is_named_in_yaml(kind):
    with initialize_config_dir(str(CONFIG_DIR / "render"), version_base="1.3"):
        cfg = compose("render", overrides=[f"tone_map={kind.__name__.lower()}"])
    assert type(instantiate(cfg.tone_map, stops=-1.5)) is kind
