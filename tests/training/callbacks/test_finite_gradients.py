"""Before a step that would ruin the weights, training stops and the batches of that step are written."""

import json

import pytest
import torch
from safetensors import safe_open
from trainers import RecordingModule, StillTrainer, batch_of

from rfpp.training.callbacks.finite_gradients import FiniteGradients, NonFiniteGradientError


@pytest.fixture
def training(tmp_path):
    """The callback, and a function that takes batches with their losses, then steps with this gradient."""
    weight = torch.nn.Parameter(torch.ones(3))
    optimizer = torch.optim.SGD([weight], lr=0.1)
    callback, module = FiniteGradients(str(tmp_path / "bad")), RecordingModule()

    def step(number, gradient, *batches):
        trainer = StillTrainer(global_step=number, accumulate_grad_batches=len(batches))
        for index, (batch, loss) in enumerate(batches):
            callback.on_train_batch_start(trainer, module, batch, index)
            callback.on_before_backward(trainer, module, torch.tensor(loss / len(batches)))
        weight.grad = torch.tensor(gradient)
        callback.on_before_optimizer_step(trainer, module, optimizer)

    return step


def test_finite_gradients_pass_and_leave_nothing(training, tmp_path):
    training(0, [1.0, 2.0, 3.0], (batch_of([4]), 1.0))
    assert not (tmp_path / "bad").exists()


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_the_batches_of_the_step_are_written_and_no_earlier_ones(training, tmp_path, bad):
    training(10, [1.0, 0.0, 0.0], (batch_of([9]), 1.0))
    batches = batch_of([4], [2, 3]), batch_of([5])
    with pytest.raises(NonFiniteGradientError, match=r"step 12: the loss or its gradient is not finite.*/bad: look"):
        training(11, [1.0, bad, 0.0], (batches[0], 8.0), (batches[1], float("nan")))
    files = sorted((tmp_path / "bad").iterdir())
    assert [file.name for file in files] == [f"step-00000012-rank0-batch{i}.safetensors" for i in range(2)]
    for file, batch, loss in zip(files, batches, ("8.0", "nan"), strict=True):
        with safe_open(file, "pt") as stored:
            about = stored.metadata()
            assert torch.equal(stored.get_tensor("positions"), batch.positions)
            assert torch.equal(stored.get_tensor("scenes"), batch.scenes.offsets)
        assert tuple(json.loads(about["keys"])) == batch.keys
        assert (about["loss"], about["step"], about["rank"]) == (loss, "12", "0")
