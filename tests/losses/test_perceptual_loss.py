import pytest
import torch
from random_vgg import random_trunk

from rfpp.imaging.radiance import log_decode, log_encode
from rfpp.losses import perceptual as perceptual_module
from rfpp.losses.perceptual import PerceptualLoss
from rfpp.metrics.image import ImageMetrics
from rfpp.metrics.lpips import LPIPS


@pytest.fixture(scope="module")
def lpips() -> LPIPS:
    return LPIPS(random_trunk())


@pytest.fixture
def make_loss(monkeypatch):
    monkeypatch.setattr(perceptual_module, "load_trunk", random_trunk)
    return PerceptualLoss


def _views(seed: int, scenes: int = 2, views: int = 2) -> torch.Tensor:
    return 0.8 * torch.rand(scenes, views, 3, 16, 16, generator=torch.Generator().manual_seed(seed))


def test_is_the_mean_of_the_lpips_metric(make_loss, lpips) -> None:
    predicted_log, target = log_encode(_views(0)), _views(1)
    metric = ImageMetrics(lpips)(log_decode(predicted_log).flatten(0, 1), target.flatten(0, 1))["lpips"]
    torch.testing.assert_close(make_loss()(predicted_log, target), metric.mean())


def test_descending_its_gradient_lowers_it(make_loss) -> None:
    loss, target = make_loss(), _views(1)
    predicted_log = log_encode(_views(0)).requires_grad_()
    before = loss(predicted_log, target)
    before.backward()
    step = 0.02 * predicted_log.grad / predicted_log.grad.abs().max()
    assert loss(predicted_log.detach() - step, target) < before.item()


def test_only_the_first_images_are_read(make_loss) -> None:
    predicted_log, target = log_encode(_views(0)).requires_grad_(), _views(1)
    loss = make_loss(images_per_step=3)(predicted_log, target)
    torch.testing.assert_close(loss, make_loss()(predicted_log.flatten(0, 1)[:3], target.flatten(0, 1)[:3]))
    loss.backward()
    touched = predicted_log.grad.flatten(0, 1).abs().amax(dim=(1, 2, 3)) > 0
    assert touched.tolist() == [True, True, True, False]


def test_zero_images_are_refused(make_loss) -> None:
    with pytest.raises(ValueError, match="images_per_step"):
        make_loss(images_per_step=0)
