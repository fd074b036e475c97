"""Each metric on HDR images against a formula in float64 or another library, and in float32 whatever surrounds it."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity
from torch import nn

from rfpp.metrics.image import ImageMetrics

#: Half the width of SSIM's window.
BORDER = 5


@pytest.fixture
def metrics(random_lpips) -> ImageMetrics:
    return ImageMetrics(random_lpips)


@pytest.fixture
def pair() -> tuple[torch.Tensor, torch.Tensor]:
    """Two references [2, 3, 48, 40] from 1e-5 to 5e3 with black pixels, and predictions that err by about a fifth."""
    rng = np.random.default_rng(0)
    smooth = torch.from_numpy(rng.normal(-1.2, 1.0, (2, 3, 7, 6))).float()
    exponent = nn.functional.interpolate(smooth, size=(48, 40), mode="bilinear")
    exponent[:, :, 3:9, 4:30] = torch.linspace(-5, 3.7, 26)
    reference = 10**exponent
    reference[:, :, 20:26] = 0.0
    noise = torch.from_numpy(rng.normal(1.0, 0.2, reference.shape)).float()
    return (reference * noise + 1e-3).clamp_min(0), reference


def _tone_mapped(image: torch.Tensor) -> np.ndarray:
    return np.clip(np.log2(1 + image.double().numpy()), 0, 1)


@pytest.mark.parametrize(
    ("name", "formula"),
    [
        ("log_l1", lambda x, y: np.abs(np.log10(1 + x) - np.log10(1 + y)).mean()),
        ("l1", lambda x, y: np.abs(x - y).mean()),
        ("mape", lambda x, y: (np.abs(x - y) / (np.abs(y) + 0.01)).mean()),
    ],
)
def test_pixelwise_errors_are_their_formula_in_float64(metrics, pair, name, formula) -> None:
    values = metrics(*pair)[name]
    for value, x, y in zip(values.tolist(), *(images.double().numpy() for images in pair), strict=True):
        assert value == pytest.approx(formula(x, y), rel=1e-5)


def test_psnr_is_its_formula_on_the_tone_mapped_image(metrics, pair) -> None:
    x, y = map(_tone_mapped, pair)
    expected = 10 * np.log10(1 / ((x - y) ** 2).mean(axis=(1, 2, 3)))
    assert metrics(*pair)["psnr"].tolist() == pytest.approx(expected.tolist(), abs=1e-3)


def test_ssim_is_skimages_when_the_border_is_mirrored_for_it(metrics, pair) -> None:
    """skimage's own border repeats the edge and is excluded from its mean; here it sees what ours sees."""
    values = metrics(*pair)["ssim"]
    for value, x, y in zip(values.tolist(), *map(_tone_mapped, pair), strict=True):
        edges = ((0, 0), (BORDER, BORDER), (BORDER, BORDER))
        _, similarity = structural_similarity(
            np.pad(x, edges, mode="reflect"), np.pad(y, edges, mode="reflect"),
            channel_axis=0, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True,
        )  # fmt: skip
        inside = similarity[:, BORDER:-BORDER, BORDER:-BORDER]
        assert value == pytest.approx(inside.mean(), abs=2e-5)
        assert abs(inside.mean() - similarity.mean()) > 1e-3  # the border matters, so the tolerance says something


def test_lpips_is_of_the_tone_mapped_image(metrics, pair, random_lpips) -> None:
    x, y = (torch.from_numpy(2 * _tone_mapped(images) - 1).float() for images in pair)
    torch.testing.assert_close(metrics(*pair)["lpips"], random_lpips(x, y), rtol=1e-3, atol=1e-5)


def test_identical_images_are_perfect(metrics, pair) -> None:
    for image in (pair[1], torch.zeros_like(pair[1])):
        values = metrics(image, image)
        for name in ("log_l1", "l1", "mape", "lpips"):
            assert values[name].tolist() == [0.0, 0.0], name
        assert values["ssim"].tolist() == pytest.approx([1.0, 1.0], abs=1e-6)
        assert values["psnr"].isposinf().all()


def test_values_are_the_same_inside_a_bf16_autocast(metrics, pair) -> None:
    expected = metrics(*pair)
    with torch.autocast("cpu", torch.bfloat16):
        values = metrics(*pair)
    for name in metrics.names:
        assert values[name].dtype == torch.float32
        assert torch.equal(values[name], expected[name]), name
