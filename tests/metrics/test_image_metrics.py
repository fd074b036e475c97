import math

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from rfpp.metrics.image import METRICS, ImageMetrics


@pytest.fixture
def metrics(random_lpips) -> ImageMetrics:
    return ImageMetrics(random_lpips)


def _pair(seed: int = 0, n: int = 3, size: int = 48) -> tuple[torch.Tensor, torch.Tensor]:
    """Smooth HDR images with a few very bright pixels, and noisy versions of them."""
    rng = np.random.default_rng(seed)
    coarse = torch.from_numpy(rng.lognormal(-1.5, 0.8, (n, 3, 6, 6))).float()
    reference = torch.nn.functional.interpolate(coarse, size=(size, size), mode="bilinear")
    reference[:, :, 5, 7] = 300.0
    noise = torch.from_numpy(rng.normal(0, 0.05, reference.shape)).float()
    return (reference + noise).clamp_min(0), reference


def test_equals_loops_over_pixels(metrics) -> None:
    prediction, reference = _pair(n=2, size=16)
    values = metrics(prediction, reference)
    for n in range(2):
        pixels = list(zip(prediction[n].flatten().tolist(), reference[n].flatten().tolist(), strict=True))
        tone = [[min(max(math.log2(1 + v), 0), 1) for v in pair] for pair in pixels]
        expected = {
            "log_l1": sum(abs(math.log10(1 + x) - math.log10(1 + y)) for x, y in pixels) / len(pixels),
            "l1": sum(abs(x - y) for x, y in pixels) / len(pixels),
            "mape": sum(abs(x - y) / (abs(y) + 0.01) for x, y in pixels) / len(pixels),
            "psnr": 10 * math.log10(1 / (sum((x - y) ** 2 for x, y in tone) / len(tone))),
        }
        for name, value in expected.items():
            assert values[name][n].item() == pytest.approx(value, rel=1e-4), name


def test_ssim_equals_skimage_away_from_the_border(metrics) -> None:
    """Both images are constant near the border, so that neither library's treatment of it matters."""
    prediction, reference = _pair(n=1, size=64)
    inner = torch.zeros(1, 1, 64, 64, dtype=torch.bool)
    inner[..., 12:52, 12:52] = True
    prediction, reference = (torch.where(inner, image, 0.2) for image in (prediction, reference))
    x, y = (np.clip(np.log2(1 + image[0].double().numpy()), 0, 1) for image in (prediction, reference))
    _, similarity = structural_similarity(
        x, y, channel_axis=0, data_range=1.0, gaussian_weights=True, use_sample_covariance=False, full=True
    )
    assert metrics(prediction, reference)["ssim"].item() == pytest.approx(similarity.mean(), abs=1e-4)


def test_identical_images(metrics) -> None:
    _, reference = _pair()
    values = metrics(reference, reference)
    for name in ("log_l1", "l1", "mape", "lpips"):
        assert values[name].abs().max() == 0, name
    torch.testing.assert_close(values["ssim"], torch.ones(3))
    assert values["psnr"].isposinf().all()


def test_black_prediction_has_closed_forms(metrics) -> None:
    _, reference = _pair()
    values = metrics(torch.zeros_like(reference), reference)
    torch.testing.assert_close(values["l1"], reference.mean(dim=(1, 2, 3)))
    torch.testing.assert_close(values["mape"], (reference / (reference + 0.01)).mean(dim=(1, 2, 3)))
    assert (values["mape"] < 1).all()


def test_mape_of_a_nearly_black_reference_is_bounded_by_its_epsilon(metrics) -> None:
    reference, prediction = torch.full((1, 3, 16, 16), 1e-7), torch.full((1, 3, 16, 16), 0.02)
    assert metrics(prediction, reference)["mape"].item() == pytest.approx(2.0, rel=1e-4)


def test_better_images_score_better_in_the_stated_direction(metrics) -> None:
    prediction, reference = _pair()
    near = metrics(0.1 * prediction + 0.9 * reference, reference)
    far = metrics(prediction, reference)
    for name, metric in METRICS.items():
        sign = 1 if metric.higher_is_better else -1
        assert (sign * (near[name] - far[name]) > 0).all(), name


def test_values_are_per_image(metrics) -> None:
    prediction, reference = _pair()
    together = metrics(prediction, reference)
    for n in range(3):
        alone = metrics(prediction[n : n + 1], reference[n : n + 1])
        for name in METRICS:
            torch.testing.assert_close(together[name][n : n + 1], alone[name], rtol=1e-4, atol=1e-6)


def test_computed_in_float32_under_bf16_autocast(metrics) -> None:
    prediction, reference = _pair()
    expected = metrics(prediction, reference)
    with torch.autocast("cpu", torch.bfloat16):
        values = metrics(prediction, reference)
    for name in METRICS:
        assert values[name].dtype == torch.float32
        assert torch.equal(values[name], expected[name]), name


def test_a_nan_prediction_is_not_hidden(metrics) -> None:
    prediction, reference = _pair(n=1)
    prediction[0, 0, 0, 0] = float("nan")
    assert all(value.isnan().all() for value in metrics(prediction, reference).values())


def test_without_lpips_its_column_is_absent() -> None:
    metrics = ImageMetrics(lpips=None)
    assert "lpips" not in metrics.names
    assert tuple(metrics(*_pair())) == metrics.names
