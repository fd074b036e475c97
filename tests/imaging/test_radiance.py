import math

import pytest
import torch

from rfpp.imaging.radiance import log_decode, log_encode, perceptual, srgb


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


@pytest.mark.parametrize("encoding", [log_encode, log_decode, perceptual, srgb])
def test_nan_stays_nan(encoding) -> None:
    assert encoding(torch.tensor([float("nan")])).isnan().all()
