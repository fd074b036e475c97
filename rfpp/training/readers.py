"""Readers: in which order, and by which library, training reads stored scenes."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from rfpp.errors import UserError
from rfpp.shards.order import ShuffledOrder, truncated
from rfpp.training.batching import Batching
from rfpp.training.loader import SkippingCorrupt
from rfpp.training.prefetch import FetchedAhead
from rfpp.training.source import DataSource
from rfpp.training.streaming import StreamedViews
from rfpp.training.views import GlobalBatches, Share, TrainingViews


@runtime_checkable
class Reader(Protocol):
    """Returns a DataLoader's data set and batches: the share of a rank in a run's global batches."""

    #: Name in conf/datamodule/reader.
    name: str

    def __call__(
        self, views: TrainingViews, source: DataSource, batching: Batching, share: Share, workers: int
    ) -> dict[str, Any]: ...


class IndexedReader:
    """Single scenes by their byte offsets: the same global batches for any number of ranks and loader processes."""

    name = "indexed"

    def __call__(
        self, views: TrainingViews, source: DataSource, batching: Batching, share: Share, workers: int
    ) -> dict[str, Any]:
        sizes = truncated(views.split.sizes, source.training_scenes or len(views.split))
        order = ShuffledOrder(sizes, views.seed, batching.shuffle_shards)
        batches = GlobalBatches(
            FetchedAhead(order, views.split) if views.split.is_remote else order,
            batching.partition,
            lambda draw: source.triangles(views.split, draw[1]),
            batching.scenes_per_step,
            share,
        )
        return {"dataset": SkippingCorrupt(views) if source.skip_corrupt else views, "batch_sampler": batches}


class WebDatasetReader:
    """Whole shards in sequence, by webdataset: for slow disks and object stores, see `StreamedViews`.

    Args:
        buffer: Scenes among which each loader process shuffles.
    """

    name = "webdataset"

    def __init__(self, buffer: int):
        if buffer < 1:
            raise ValueError(f"datamodule.reader.buffer={buffer}: use 1 or more")
        self.buffer = buffer

    def __call__(
        self, views: TrainingViews, source: DataSource, batching: Batching, share: Share, workers: int
    ) -> dict[str, Any]:
        """Return the data set. Raises UserError if there are fewer shards than loader processes."""
        sizes = truncated(views.split.sizes, source.training_scenes or len(views.split))
        if len(sizes) < (processes := share.ranks * max(workers, 1)):
            raise UserError(
                f"{len(sizes)} shards do not divide among {processes} loader processes: lower datamodule.workers, or "
                "choose datamodule.reader=indexed"
            )
        scenes = batching.scenes_per_step // (share.ranks * share.accumulate)
        streamed = StreamedViews(views, sizes, share, scenes, self.buffer, source.skip_corrupt)
        return {"dataset": streamed, "batch_size": scenes}
