"""Progress of training in outputs without a terminal."""

import pytest
import torch
from trainers import RecordingModule, StillTrainer

from rfpp.training.callbacks.progress import TrainingProgress


@pytest.mark.parametrize("rank", [0, 1])
def test_the_first_rank_writes_steps_and_loss(capsys, rank):
    trainer = StillTrainer(max_steps=30, log_every_n_steps=5, is_global_zero=rank == 0)
    callback, module = TrainingProgress(), RecordingModule()
    callback.on_train_start(trainer, module)
    for step in range(1, 12):
        trainer.global_step = step
        trainer.callback_metrics = {"train/loss": torch.tensor(1 / step)}
        callback.on_train_batch_end(trainer, module)
    callback.on_train_end(trainer, module)
    output = capsys.readouterr().out
    assert ("steps 10 of 30" in output and "left, loss 0.1000" in output) == (rank == 0)
