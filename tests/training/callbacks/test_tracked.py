"""The journal is flushed before a checkpoint; complete runs register their best one, without its training state."""

import signal

import pytest
import torch
from trainers import RecordingModule, StillTrainer

from rfpp.checkpoint.loading import CHECKPOINT_KEY
from rfpp.training.callbacks.tracked import TrackedRun, without_training_state
from rfpp.training.stopping import StoppedError
from rfpp.training.tracking.local import LocalLogger


class Logger(LocalLogger):
    """Remembers what it is asked."""

    def __init__(self, folder):
        super().__init__("run", folder)
        self.asked = []

    def sync(self):
        self.asked.append("sync")

    def will_go_on(self):
        self.asked.append("will_go_on")

    def register_model(self, name, checkpoint):
        self.asked.append((name, checkpoint))


class Checkpoints:
    def __init__(self, best):
        self.best_model_path = str(best)


@pytest.fixture
def best(tmp_path):
    content = {CHECKPOINT_KEY: {"steps": 7}, "state_dict": {"w": torch.arange(3.0)}, "optimizer_states": [{"m": 1}]}
    torch.save(content, tmp_path / "best.ckpt")
    return tmp_path / "best.ckpt"


def ended(tmp_path, best, model="rfpp-test", **attributes):
    logger = Logger(tmp_path)
    trainer = StillTrainer(**{"global_step": 20, "max_steps": 20, "loggers": [logger]} | attributes)
    trainer.checkpoint_callback = Checkpoints(best)
    TrackedRun(model).on_fit_end(trainer, RecordingModule())
    return logger.asked


def test_the_best_checkpoint_of_a_complete_run_is_registered(tmp_path, best):
    assert ended(tmp_path, best) == [("rfpp-test", tmp_path / "model.ckpt")]
    registered = torch.load(tmp_path / "model.ckpt", weights_only=True)
    assert registered.keys() == {CHECKPOINT_KEY, "state_dict"}
    assert torch.equal(registered["state_dict"]["w"], torch.arange(3.0))


@pytest.mark.parametrize("why", ["incomplete", "other rank", "no name", "no checkpoint"])
def test_nothing_else_is(tmp_path, best, why):
    attributes = {"incomplete": {"global_step": 19}, "other rank": {"is_global_zero": False}}.get(why, {})
    path = "" if why == "no checkpoint" else best
    assert ended(tmp_path, path, None if why == "no name" else "rfpp-test", **attributes) == []


def test_what_is_registered_replaces_what_was_there_and_leaves_nothing_beside(tmp_path, best):
    target = tmp_path / "model.ckpt"
    target.write_bytes(b"old")
    assert without_training_state(best, target) == target
    assert sorted(path.name for path in tmp_path.iterdir()) == ["best.ckpt", "model.ckpt"]
    assert torch.load(target, weights_only=True)[CHECKPOINT_KEY] == {"steps": 7}


@pytest.mark.parametrize(
    ("error", "asked"), [(StoppedError("stopped", signal.SIGTERM), ["will_go_on"]), (ValueError(), [])]
)
def test_a_run_that_is_stopped_goes_on_and_one_that_fails_does_not(tmp_path, error, asked):
    logger = Logger(tmp_path)
    TrackedRun(None).on_exception(StillTrainer(loggers=[logger]), RecordingModule(), error)
    assert logger.asked == asked
