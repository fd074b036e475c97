"""Training stops before a step that would ruin the weights, and names the scenes of that step."""

import json

import pytest
import torch
from trainers import RecordingModule, StillTrainer, batch_of

from rfpp.training.callbacks.finite_gradients import FiniteGradients, NonFiniteGradientError


@pytest.fixture
def training(tmp_path):
    """A function that runs the callback on batches with their losses, then on a step with this gradient."""
    weight = torch.nn.Parameter(torch.ones(3))
    optimizer = torch.optim.SGD([weight], lr=0.1)
    module, strict = RecordingModule(), FiniteGradients(str(tmp_path / "bad"), skip=0)

    def step(number, gradient, *batches, callback=strict):
        trainer = StillTrainer(global_step=number, accumulate_grad_batches=len(batches))
        for index, (batch, loss) in enumerate(batches):
            callback.on_train_batch_start(trainer, module, batch, index)
            callback.on_before_backward(trainer, module, torch.tensor(loss / len(batches)))
        weight.grad = torch.tensor(gradient)
        callback.on_before_optimizer_step(trainer, module, optimizer)
        return weight.grad

    return step


def test_finite_gradients_pass_and_leave_nothing(training, tmp_path):
    training(0, [1.0, 2.0, 3.0], (batch_of([4]), 1.0))
    assert not (tmp_path / "bad").exists()


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_scenes_and_losses_of_the_step_are_written_and_no_earlier_ones(training, tmp_path, bad):
    training(10, [1.0, 0.0, 0.0], (batch_of([9]), 1.0))
    batches = batch_of([4], [2, 3]), batch_of([5])
    with pytest.raises(NonFiniteGradientError, match=r"step 12: the loss or its gradient is not finite.*rank0\.json"):
        training(11, [1.0, bad, 0.0], (batches[0], 8.0), (batches[1], float("nan")))
    (file,) = (tmp_path / "bad").iterdir()
    assert file.name == "step-00000012-rank0.json"
    assert json.loads(file.read_text()) == [
        {"scenes": list(batches[0].keys), "loss": "8.0"}, {"scenes": list(batches[1].keys), "loss": "nan"}
    ]  # fmt: skip


def test_as_many_steps_as_allowed_are_skipped(training, tmp_path):
    tolerant, bad = FiniteGradients(str(tmp_path / "bad"), skip=1), [float("inf"), 0.0, 0.0]
    with pytest.warns(UserWarning, match=r"step 6 is skipped: its gradient is not finite; .*rank0\.json lists"):
        gradient = training(5, bad, (batch_of([4]), 1.0), callback=tolerant)
    assert not gradient.any()
    with pytest.raises(NonFiniteGradientError):
        training(6, bad, (batch_of([4]), 1.0), callback=tolerant)
