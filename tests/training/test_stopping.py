"""Signals are remembered from the start, and checkpoints are written by steps and by the clock."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import lightning as L
import pytest
from small_data import make
from training_runs import SETTINGS

from rfpp.batch import RaggedBatch
from rfpp.training.callbacks import resumable_checkpoints
from rfpp.training.callbacks.resumable_checkpoints import ResumableCheckpoints
from rfpp.training.signals import STOP_SIGNALS, StopSignals
from rfpp.training.stopping import StoppedError

REPOSITORY = Path(__file__).resolve().parents[2]


def catches(process: subprocess.Popen, number: signal.Signals) -> bool:
    """Return whether the process handles this signal."""
    caught = Path(f"/proc/{process.pid}/status").read_text().partition("SigCgt:")[2].split()[0]
    return bool(int(caught, 16) >> (number - 1) & 1)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="asks Linux which signals a process catches")
def test_a_signal_while_the_program_is_imported_is_not_its_death(tmp_path):
    data = make(tmp_path / "data", splits={"train": 4, "validation": 1}).root
    command = [sys.executable, "launch/train.py", *SETTINGS, f"data.root={data}", f"logger.folder={tmp_path}"]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1"}
    running = {
        number: subprocess.Popen(
            [*command, f"run_dir={tmp_path}/{number.name}"],
            cwd=REPOSITORY, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )
        for number in (signal.SIGUSR1, signal.SIGINT)
    }  # fmt: skip
    for number, process in running.items():
        while not catches(process, signal.SIGUSR1):  # the last but one to be watched; SIGINT Python itself catches
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.001)
        process.send_signal(number)
    for number, process in running.items():
        _, said = process.communicate(timeout=120)
        assert process.returncode == 128 + number, said
        assert f"stopped by {number.name} after step 0 of 20: resume with the same command and run_dir=" in said


def test_a_second_control_c_ends_at_once_and_watching_imports_nothing_that_takes_long():
    program = """
import sys
from signal import SIGINT, raise_signal
from rfpp.training.signals import STOP_SIGNALS
assert not {"numpy", "torch", "lightning"} & set(sys.modules)
STOP_SIGNALS.watch()
raise_signal(SIGINT)
STOP_SIGNALS.watch()  # as a callback does when training begins
print(STOP_SIGNALS.received.name, flush=True)
raise_signal(SIGINT)
print("still there")
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, cwd=REPOSITORY)
    assert run.returncode == -signal.SIGINT, run.stderr
    assert run.stdout == "SIGINT\n"
    assert run.stderr == "\nstopping after this step; Ctrl-C again ends at once\n"


@pytest.fixture
def handlers():
    """Puts the process's handlers back."""
    numbers = (signal.SIGUSR1, signal.SIGTERM, signal.SIGINT)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
    STOP_SIGNALS.take()


@pytest.mark.parametrize("order", [("SIGUSR1", "SIGTERM"), ("SIGTERM", "SIGUSR1"), ("SIGTERM", "SIGINT")])
def test_the_wish_to_end_prevails(handlers, order):
    signals = StopSignals()
    signals.watch()
    for name in order:
        signal.raise_signal(signal.Signals[name])
    assert signals.take() == signal.SIGTERM
    assert signals.take() is None


class Steps(L.Trainer):
    """A trainer of steps that take so many seconds of a clock, and so many seconds to save."""

    world_size, is_global_zero, accumulate_grad_batches = 1, True, 2
    global_step = max_steps = 0
    strategy = SimpleNamespace(checkpoint_io=SimpleNamespace(wait=lambda: None))

    def __init__(self, monkeypatch, steps: int, seconds: float, saving: float):
        self.max_steps, self.seconds, self.saving, self.now = steps, seconds, saving, 1000.0
        self.saved: list[int] = []
        monkeypatch.setattr(resumable_checkpoints, "monotonic", lambda: self.now)

    def save_checkpoint(self, path: Path, storage_options: Callable[[], None]) -> None:
        path.touch()
        storage_options()
        self.saved.append(self.global_step)
        self.now += self.saving

    def train(self, callback: ResumableCheckpoints) -> list[int]:
        """Return the steps after which the callback saved."""
        module, batch = L.LightningModule(), RaggedBatch.__new__(RaggedBatch)  # not used
        callback.on_train_start(self, module)
        for index in range(self.max_steps * self.accumulate_grad_batches):
            callback.on_train_batch_start(self, module, batch, index)
            self.now += self.seconds / self.accumulate_grad_batches
            self.global_step += index % self.accumulate_grad_batches
        callback.on_train_epoch_end(self, module)
        return self.saved


@pytest.mark.parametrize(
    ("minutes", "every", "seconds", "saving", "expected"),
    [
        (2.0, 500, 30.0, 1.0, [4, 8, 10]),
        (2.0, 3, 30.0, 1.0, [3, 6, 9, 10]),  # whichever comes first; then time starts again
        (None, 500, 30.0, 1.0, [10]),
        (2.0, 500, 130.0, 13.0, [1, 3, 5, 7, 9, 10]),  # 13 s are too many for every two minutes
        (2.0, 500, 130.0, 30.0, [1, 6, 10]),
    ],
)
def test_checkpoints_are_saved_by_steps_and_by_time(
    handlers, monkeypatch, tmp_path, minutes, every, seconds, saving, expected
):
    trainer = Steps(monkeypatch, 10, seconds, saving)
    callback = ResumableCheckpoints(str(tmp_path), every, minutes, keep=3, keep_every_n_steps=500)
    assert trainer.train(callback) == expected


def test_a_signal_before_training_stops_it_before_its_first_step(handlers, monkeypatch, tmp_path):
    STOP_SIGNALS.watch()
    signal.raise_signal(signal.SIGTERM)
    trainer = Steps(monkeypatch, 10, 1.0, 1.0)
    with pytest.raises(StoppedError, match="SIGTERM after step 0 of 10") as stopped:
        trainer.train(ResumableCheckpoints(str(tmp_path), 1, None, keep=3, keep_every_n_steps=500))
    assert stopped.value.signal == signal.SIGTERM
    assert trainer.saved == []
    assert STOP_SIGNALS.received is None
