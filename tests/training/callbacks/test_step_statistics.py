"""Statistics over windows of steps, by a clock that the tests set."""

from types import SimpleNamespace

import pytest
import torch
from trainers import Recorder, RecordingModule, StillTrainer, batch_of

from rfpp.training.callbacks import step_statistics
from rfpp.training.callbacks.step_statistics import StepStatistics


class Clock:
    now = 100.0

    def perf_counter(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(step_statistics, "time", clock)
    monkeypatch.setattr(step_statistics, "published_peak", lambda device, dtype: 1000.0)

    def counted(network, batch):
        clock.now += 50  # a forward pass, which is not training time
        return 80.0

    monkeypatch.setattr(step_statistics, "training_flops", counted)
    return clock


def trainer_with(**attributes):
    return StillTrainer(datamodule=SimpleNamespace(scenes_per_batch=2), loggers=[Recorder()], **attributes)


def train(clock, callback, trainer, batches, waiting=0.5, working=2.0, start=True):
    module = RecordingModule(network=SimpleNamespace(patch_size=4))
    if start:
        callback.on_train_start(trainer, module)
    batch = batch_of([4], [2, 3])  # two scenes, two views of 8 × 8 pixels each, nine triangles
    for index in range(batches):
        clock.now += waiting
        callback.on_train_batch_start(trainer, module, batch, index)
        clock.now += working
        trainer.global_step += (index + 1) % trainer.accumulate_grad_batches == 0
        outputs = {"tokens": torch.tensor(10), "terms": {"train/loss": torch.tensor(0.1 * index)}}
        callback.on_train_batch_end(trainer, module, outputs, batch, index)
    return module.logged


def test_rates_of_a_window_exclude_the_time_of_counting_operations(clock):
    values = train(clock, StepStatistics(every_n_steps=4), trainer_with(), 4)
    assert values.pop("memory/resident") > 0.1
    assert values == pytest.approx({
        "throughput/steps_per_s": 0.4, "throughput/scenes_per_s": 0.8, "throughput/images_per_s": 1.6,
        "throughput/triangles_per_s": 3.6, "throughput/tokens_per_s": (10 + 4 * 4) * 0.4,
        "throughput/data_wait_fraction": 0.2, "throughput/data_wait_rank": 0.0,
        "throughput/flop_utilization": 80 * 0.4 / 1000, "data/skipped": 0, "train/loss": 0.3,
    })  # fmt: skip


def test_accumulated_batches_are_one_step_and_devices_add_up_or_the_slowest_counts(clock):
    added = SimpleNamespace(
        root_device=torch.device("cpu"),
        reduce=lambda x, reduce_op: 3 * x,
        all_gather=lambda x: torch.stack([x, 4 * x, 2 * x]),
    )
    trainer = trainer_with(accumulate_grad_batches=2, world_size=3, strategy=added)
    values = train(clock, StepStatistics(every_n_steps=2), trainer, 4)
    assert values["train/loss"] == pytest.approx((0.2 + 0.3) / 2)
    assert values["throughput/data_wait_fraction"] == pytest.approx(4 * 0.2)
    assert values["throughput/data_wait_rank"] == 1
    assert values["throughput/steps_per_s"] == pytest.approx(0.2)
    assert values["throughput/scenes_per_s"] == pytest.approx(3 * 0.8)


def test_a_window_goes_on_after_validation_without_its_time(clock):
    callback, trainer = StepStatistics(every_n_steps=2), trainer_with()
    assert train(clock, callback, trainer, 1) == {}
    callback.on_validation_start(trainer, RecordingModule())
    clock.now += 1000
    callback.on_validation_end(trainer, RecordingModule())
    values = train(clock, callback, trainer, 1, start=False)
    assert values["throughput/steps_per_s"] == pytest.approx(0.4)
    assert values["throughput/data_wait_fraction"] == pytest.approx(0.2)


def test_skipped_scenes_are_counted_from_the_start(clock):
    trainer = trainer_with()
    trainer.datamodule.scenes_per_batch = 5
    assert train(clock, StepStatistics(every_n_steps=1), trainer, 4)["data/skipped"] == 4 * 3


def test_utilization_is_omitted_where_no_peak_rate_is_published(clock, monkeypatch):
    monkeypatch.setattr(step_statistics, "published_peak", lambda device, dtype: None)
    values = train(clock, StepStatistics(every_n_steps=4), trainer_with(), 4)
    assert "throughput/flop_utilization" not in values
    assert clock.now == 110  # nothing was counted
