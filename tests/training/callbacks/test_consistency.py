"""The residuals of the transport's iterations are logged, each under its own name."""

import pytest
import torch
from trainers import RecordingModule, StillTrainer, batch_of

from rfpp.training.callbacks.consistency import ConsistencyMonitor


def logged(outputs):
    module = RecordingModule()
    ConsistencyMonitor().on_train_batch_end(StillTrainer(), module, outputs, batch_of([4]), 0)
    return module.logged


def test_each_iteration_has_a_name_and_the_last_is_compared_with_the_first():
    residuals = torch.tensor([0.5, 0.2, 0.1], requires_grad=True)
    outputs = {f"consistency_{k}": value for k, value in enumerate(residuals, start=1)}
    assert logged(outputs | {"loss": torch.tensor(1.0)}) == pytest.approx(
        {"consistency/k1": 0.5, "consistency/k2": 0.2, "consistency/k3": 0.1, "consistency/last_over_first": 0.2}
    )


def test_a_network_without_an_operator_logs_nothing():
    assert logged({"loss": torch.tensor(1.0)}) == {}


def test_a_residual_of_zero_divides_nothing_by_zero():
    values = logged({"consistency_1": torch.tensor(0.0), "consistency_2": torch.tensor(0.0)})
    assert values["consistency/last_over_first"] == 0
