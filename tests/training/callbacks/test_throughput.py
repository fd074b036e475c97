"""Rates over windows of steps, by a clock that the tests set."""

from types import SimpleNamespace

import pytest
import torch
from trainers import RecordingModule, StillTrainer, batch_of

from rfpp.training.callbacks import throughput
from rfpp.training.callbacks.throughput import Throughput


class Clock:
    now = 100.0

    def perf_counter(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(throughput, "time", clock)
    monkeypatch.setattr(throughput, "matrix_product_rate", lambda device, dtype: 1000.0)

    def counted(network, batch):
        clock.now += 50  # a forward pass, which is no training
        return 80.0

    monkeypatch.setattr(throughput, "training_flops", counted)
    return clock


def train(clock, callback, trainer, batches, waiting=0.5, working=2.0, start=True):
    module = RecordingModule(network=SimpleNamespace(patch_size=4))
    if start:
        callback.on_train_start(trainer, module)
    batch = batch_of([4], [2, 3])  # two scenes, two views of 8 × 8 pixels each, nine triangles
    for index in range(batches):
        clock.now += waiting
        callback.on_train_batch_start(trainer, module, batch, index)
        clock.now += working
        callback.on_train_batch_end(trainer, module, {"tokens": torch.tensor(10)}, batch, index)
        trainer.global_step += (index + 1) % trainer.accumulate_grad_batches == 0
    return module.logged


def test_rates_of_a_window_do_not_count_the_time_of_counting(clock):
    values = train(clock, Throughput(every_n_steps=4, count_every_n_steps=500), StillTrainer(), 4)
    assert values == pytest.approx({
        "throughput/steps_per_s": 0.4, "throughput/scenes_per_s": 0.8, "throughput/images_per_s": 1.6,
        "throughput/triangles_per_s": 3.6, "throughput/tokens_per_s": (10 + 4 * 4) * 0.4,
        "throughput/data_wait_fraction": 0.2, "throughput/flop_utilisation": 80 * 0.4 / 1000,
    })  # fmt: skip


def test_nothing_is_logged_before_a_window_is_full(clock):
    assert train(clock, Throughput(every_n_steps=4, count_every_n_steps=500), StillTrainer(), 3) == {}


def test_accumulated_batches_are_one_step_and_devices_add_up(clock):
    trainer = StillTrainer(accumulate_grad_batches=2, world_size=3)
    values = train(clock, Throughput(every_n_steps=2, count_every_n_steps=500), trainer, 4)
    assert values["throughput/steps_per_s"] == pytest.approx(0.2)
    assert values["throughput/scenes_per_s"] == pytest.approx(3 * 0.8)


def test_validation_is_no_training_time(clock):
    callback, trainer = Throughput(every_n_steps=2, count_every_n_steps=500), StillTrainer()
    train(clock, callback, trainer, 2)
    clock.now += 1000
    callback.on_validation_end(trainer, RecordingModule())
    assert train(clock, callback, trainer, 2, start=False)["throughput/steps_per_s"] == pytest.approx(0.4)
