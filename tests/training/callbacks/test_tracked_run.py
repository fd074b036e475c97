"""The journal is flushed before a checkpoint; complete runs register their best one without its training state."""

import signal

import pytest
import torch
from lightning.pytorch.callbacks import Checkpoint, ModelCheckpoint
from trainers import RecordingModule, StillTrainer

from rfpp.checkpoint.loading import CHECKPOINT_KEY
from rfpp.training.callbacks.tracked_run import TrackedRun
from rfpp.training.stopping import StoppedError
from rfpp.training.tracking.run_logger import RunLogger


class Logger(RunLogger):
    """Records calls."""

    def __init__(self, folder):
        super().__init__("run", folder)
        self.calls = []

    def sync(self):
        self.calls.append("sync")

    def mark_stopped(self):
        self.calls.append("mark_stopped")

    def register_model(self, name, checkpoint):
        self.calls.append((name, checkpoint))


@pytest.fixture
def best(tmp_path):
    content = {CHECKPOINT_KEY: {"steps": 7}, "state_dict": {"w": torch.arange(3.0)}, "optimizer_states": [{"m": 1}]}
    torch.save(content, tmp_path / "best.ckpt")
    return tmp_path / "best.ckpt"


def calls_at_the_end(tmp_path, best, model="rfpp-test", **attributes):
    logger = Logger(tmp_path)
    trainer = StillTrainer(**{"global_step": 20, "max_steps": 20, "loggers": [logger]} | attributes)
    selection = ModelCheckpoint(monitor="validation/log_l1")
    selection.best_model_path = str(best)
    trainer.checkpoint_callbacks = [Checkpoint(), selection] if best is not None else [Checkpoint()]
    TrackedRun(model).on_fit_end(trainer, RecordingModule())
    return logger.calls


def test_the_best_checkpoint_of_a_complete_run_is_registered(tmp_path, best):
    file = tmp_path / "model" / "checkpoint.ckpt"
    assert calls_at_the_end(tmp_path, best) == calls_at_the_end(tmp_path, best) == [("rfpp-test", file)]
    registered = torch.load(file, weights_only=True)
    assert registered.keys() == {CHECKPOINT_KEY, "state_dict"}
    assert torch.equal(registered["state_dict"]["w"], torch.arange(3.0))
    assert list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize("reason", ["incomplete", "other rank", "no name", "no selection", "no checkpoint"])
def test_nothing_else_is_registered(tmp_path, best, reason):
    attributes = {"incomplete": {"global_step": 19}, "other rank": {"is_global_zero": False}}.get(reason, {})
    path = {"no selection": None, "no checkpoint": ""}.get(reason, best)
    assert calls_at_the_end(tmp_path, path, None if reason == "no name" else "rfpp-test", **attributes) == []


@pytest.mark.parametrize(
    ("error", "calls"), [(StoppedError("stopped", signal.SIGTERM), ["mark_stopped"]), (ValueError(), [])]
)
def test_only_a_stopped_run_is_marked_as_stopped(tmp_path, error, calls):
    logger = Logger(tmp_path)
    TrackedRun(None).on_exception(StillTrainer(loggers=[logger]), RecordingModule(), error)
    assert logger.calls == calls
