"""Scores of validation by the number of a scene's triangles."""

from types import SimpleNamespace

import pytest
import torch
from trainers import Recorder, RecordingModule, StillTrainer, batch_of

from rfpp.training.callbacks.scores_by_size import ScoresBySize, labels, triangles


def validated(*batches, rank=0):
    """What is logged of batches, each with a score for each view."""
    logger = Recorder()
    trainer = StillTrainer(global_step=30, loggers=[logger], is_global_zero=rank == 0)
    module = RecordingModule(metrics=SimpleNamespace(names=("l1",)))
    callback = ScoresBySize([5, 10])
    callback.on_validation_start(trainer, module)
    for index, (batch, scores) in enumerate(batches):
        callback.on_validation_batch_end(trainer, module, {"l1": torch.tensor(scores)}, batch, index)
    callback.on_validation_end(trainer, module)
    return logger.logged


def test_every_scene_counts_once_in_its_range_and_empty_ranges_are_left_out():
    first, second = batch_of([2, 2], [12]), batch_of([1])  # 4, 12 and 1 triangles, two views each
    ((step, means),) = validated((first, [1.0, 3.0, 10.0, 20.0]), (second, [6.0, 8.0]))
    assert step == 29
    assert means == pytest.approx({"validation_l1/0_to_4_triangles": 4.5, "validation_l1/10_triangles_and_more": 15.0})


def test_only_the_first_rank_logs():
    assert validated((batch_of([4]), [1.0, 1.0]), rank=1) == []


def test_an_edge_belongs_to_the_range_above_it():
    ((_, means),) = validated((batch_of([5]), [1.0, 1.0]))
    assert list(means) == ["validation_l1/5_to_9_triangles"]


def test_triangles_and_labels():
    assert triangles(batch_of([2, 3], [7], [1, 1, 1])) == [5, 7, 3]
    assert labels([5, 10]) == ["0_to_4_triangles", "5_to_9_triangles", "10_triangles_and_more"]
