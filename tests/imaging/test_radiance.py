import math

import pytest
import torch

from rfpp.imaging.radiance import linear, log_decode, log_encode, perceptual, srgb, to_8bit


def test_log_encoding_is_log10_of_one_plus_radiance() -> None:
    radiance = torch.tensor([0.0, 9.0, 99.0, 4999.0])
    torch.testing.assert_close(log_encode(radiance), torch.tensor([0.0, 1.0, 2.0, math.log10(5000)]))


def test_log_decode_inverts_log_encode_over_the_range_of_radiance() -> None:
    radiance = torch.logspace(-6, 4, 50)
    torch.testing.assert_close(log_decode(log_encode(radiance)), radiance, rtol=1e-5, atol=0)


def test_tone_map_is_log2_of_one_plus_radiance_clamped_to_white() -> None:
    radiance = torch.tensor([-0.5, 0.0, math.sqrt(2) - 1, 1.0, 800.0])
    torch.testing.assert_close(perceptual(radiance), torch.tensor([0.0, 0.0, 0.5, 1.0, 1.0]))


def test_srgb_curve_has_its_published_values() -> None:
    torch.testing.assert_close(
        srgb(torch.tensor([0.0, 0.002, 0.18, 1.0, 7.0])),
        torch.tensor([0.0, 0.02584, 0.46136, 1.0, 1.0]),
        rtol=0,
        atol=1e-5,
    )


def test_srgb_has_an_inverse_and_a_finite_gradient_at_black() -> None:
    values = torch.linspace(0, 1, 100)
    torch.testing.assert_close(linear(srgb(values)), values)
    black = torch.zeros(3, requires_grad=True)
    srgb(black).sum().backward()
    assert black.grad.isfinite().all()  # from PyTorch 2.14 on, the limits of a clamp have gradient 0


def test_to_8bit_rounds_to_the_nearest_level() -> None:
    assert to_8bit(torch.tensor([-1.0, 0.0, 0.5 / 255 + 1e-4, 0.5, 1.0, 2.0])).tolist() == [0, 0, 1, 128, 255, 255]


@pytest.mark.parametrize("encoding", [log_encode, log_decode, perceptual, srgb])
def test_nan_stays_nan(encoding) -> None:
    assert encoding(torch.tensor([float("nan")])).isnan().all()
