"""Training samples are a pure function of seed, epoch and scene, in an order shared by all ranks."""

from itertools import chain

import numpy as np
import pytest
from small_data import make

from rfpp.imaging.exr import decode_exr
from rfpp.shards import sample
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.order import ShuffledOrder
from rfpp.training.augmentation import RigidMotion
from rfpp.training.batching import BalancedBySize, Contiguous, Partition
from rfpp.training.views import GlobalBatches, Share, TrainingViews

CHANNELS = ("albedo", "normal", "position")


@pytest.fixture(scope="module")
def split(tmp_path_factory):
    manifest = make(tmp_path_factory.mktemp("views") / "small", splits={"train": 4})
    return ShardSplit(manifest.root, "train")


def test_a_draw_depends_on_seed_epoch_and_scene_only(split):
    motion = [RigidMotion(rotation=1.0, translation=0.25)]
    first, again = (TrainingViews(split, CHANNELS, 1, motion, seed=3)[5, 2] for _ in range(2))
    np.testing.assert_array_equal(first.triangles.positions, again.triangles.positions)
    np.testing.assert_array_equal(first.image, again.image)
    for other in (
        TrainingViews(split, CHANNELS, 1, motion, seed=4)[5, 2],
        TrainingViews(split, CHANNELS, 1, motion, seed=3)[6, 2],
    ):
        assert not np.allclose(first.triangles.positions, other.triangles.positions)


def triangles_of(draw: tuple[int, int]) -> int:
    return 2 ** draw[1]


def global_batches(partition: Partition, scenes_per_step: int = 4, **how) -> list[list[tuple[int, int]]]:
    order = ShuffledOrder([2, 3, 1], seed=1, window=2)
    return list(GlobalBatches(order, partition, triangles_of, scenes_per_step, Share(**{"steps": 6, **how})))


PARTITIONS = (Contiguous(), BalancedBySize())


@pytest.mark.parametrize("partition", PARTITIONS)
def test_ranks_share_each_global_batch_and_epochs_are_complete(partition):
    whole = global_batches(partition)
    assert whole == global_batches(Contiguous())
    for ranks, accumulate in ((2, 1), (4, 1), (2, 2), (1, 2), (1, 4)):
        parts = [global_batches(partition, rank=rank, ranks=ranks, accumulate=accumulate) for rank in range(ranks)]
        steps = [[part[i * accumulate : (i + 1) * accumulate] for part in parts] for i in range(6)]
        assert {len(batch) for step in steps for part in step for batch in part} == {4 // (ranks * accumulate)}
        joined = [[draw for part in step for batch in part for draw in batch] for step in steps]
        assert [sorted(step) for step in joined] == [sorted(batch) for batch in whole]
        assert joined == whole or isinstance(partition, BalancedBySize)
    draws = list(chain.from_iterable(whole))
    for epoch in range(4):
        assert sorted(index for e, index in draws if e == epoch) == list(range(6))


def test_ranks_are_balanced_however_they_accumulate():
    """Partitioned in a single step, one rank could get all the large scenes."""
    at_once = [global_batches(BalancedBySize(), rank=rank, ranks=2) for rank in (0, 1)]
    one_by_one = [global_batches(BalancedBySize(), rank=rank, ranks=2, accumulate=2) for rank in (0, 1)]
    for whole, singles in zip(at_once, one_by_one, strict=True):
        assert [sorted(batch) for batch in whole] == [
            sorted(a + b) for a, b in zip(singles[::2], singles[1::2], strict=True)
        ]


@pytest.mark.parametrize("partition", PARTITIONS)
@pytest.mark.parametrize("start", range(7))
def test_a_resumed_run_yields_the_remaining_batches(start, partition):
    for rank in (0, 1):
        rest = global_batches(partition, start=start, rank=rank, ranks=2)
        assert rest == global_batches(partition, rank=rank, ranks=2)[start:]


def test_a_batch_that_does_not_divide_among_ranks_is_refused():
    with pytest.raises(ValueError, match="5 scenes per step do not divide among 2 ranks"):
        global_batches(Contiguous(), scenes_per_step=5, ranks=2)


def test_a_training_draw_decodes_its_views_alone(split, monkeypatch):
    decoded = []
    monkeypatch.setattr(sample, "decode_exr", lambda data, name: decoded.append(name) or decode_exr(data, name))
    views = TrainingViews(split, CHANNELS, 1, [], seed=0)[0, 1]
    assert views.image.shape[0] == 1
    assert len(decoded) == 2  # the image and its surfaces, without direct light
    assert len({name.split(".")[1] for name in decoded}) == 1
