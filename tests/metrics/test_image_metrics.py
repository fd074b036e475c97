import numpy as np
import pytest
import torch

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


def test_a_nan_prediction_is_not_hidden(metrics) -> None:
    prediction, reference = _pair(n=1)
    prediction[0, 0, 0, 0] = float("nan")
    assert all(value.isnan().all() for value in metrics(prediction, reference).values())


def test_without_lpips_its_column_is_absent() -> None:
    metrics = ImageMetrics(lpips=None)
    assert "lpips" not in metrics.names
    assert tuple(metrics(*_pair())) == metrics.names
