"""A training run that diverges warns, and stops."""

import warnings

import pytest
from trainers import RecordingModule, StillTrainer, batch_of

from rfpp.training.callbacks.divergence import WINDOW, DivergenceAlarm, DivergenceError


def train(alarm: DivergenceAlarm, losses: list[float], norm: float = 1.0) -> None:
    trainer, module, batch = StillTrainer(), RecordingModule(), batch_of([3])
    for step, loss in enumerate(losses, start=1):
        trainer.global_step, trainer.callback_metrics = step, {"train/loss": loss, "train/gradient_norm": norm}
        alarm.on_train_batch_end(trainer, module, {}, batch, step - 1)


def test_a_falling_and_noisy_loss_raises_no_alarm():
    with warnings.catch_warnings(action="error"):
        train(DivergenceAlarm("run", 10.0, 1), [10 * 0.9**step * (1 + step % 3) for step in range(100)])


def test_a_spike_is_warned_of_and_training_continues():
    with pytest.warns(UserWarning, match=f"step {WINDOW + 1}: train/loss is 50 times its recent median"):
        train(DivergenceAlarm("run", 10.0, 2), [*[1.0] * WINDOW, 50.0, *[1.0] * 30])


@pytest.mark.filterwarnings("ignore:.*50 times")
def test_a_loss_that_stays_high_stops_training():
    with pytest.raises(DivergenceError, match=f"step {WINDOW + 3}: training has diverged") as diverged:
        train(DivergenceAlarm("run", 10.0, 3), [*[1.0] * WINDOW, *[50.0] * 10])
    assert list(diverged.value.steps) == [WINDOW, WINDOW + 1]
