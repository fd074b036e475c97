import pytest
import torch

from rfpp.imaging.radiance import log_encode
from rfpp.losses.log_l1 import log_l1


def test_is_zero_where_the_prediction_encodes_the_target() -> None:
    target = torch.rand(2, 2, 3, 8, 8) * 50
    assert log_l1(log_encode(target), target) == 0


def test_value_and_gradient_are_those_of_the_mean_absolute_difference() -> None:
    predicted = torch.tensor([0.5, 1.5, 2.0]).reshape(1, 3, 1, 1).requires_grad_()
    target = torch.tensor([9.0, 9.0, 99.0]).reshape(1, 3, 1, 1)  # encodes to 1, 1, 2
    loss = log_l1(predicted, target)
    assert loss.item() == pytest.approx(1 / 3)
    loss.backward()
    torch.testing.assert_close(predicted.grad.flatten(), torch.tensor([-1 / 3, 1 / 3, 0.0]))


def test_is_float32_under_bf16_autocast() -> None:
    predicted, target = torch.rand(1, 3, 4, 4), torch.rand(1, 3, 4, 4)
    with torch.autocast("cpu", torch.bfloat16):
        loss = log_l1(predicted, target)
    assert loss.dtype == torch.float32
    assert loss == log_l1(predicted, target)
    assert log_l1(predicted.bfloat16(), target).dtype == torch.float32
