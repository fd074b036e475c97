"""Whether loader processes keep up with training: images per second of each, beside each other."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from rfpp.batch import RaggedBatch
from rfpp.benchmark.cost.rows import Row
from rfpp.benchmark.cost.tasks import Setting, TrainingStep, Untrained
from rfpp.benchmark.invented import InventedData, StoredData
from rfpp.benchmark.loader_pace import LoaderPace, loader_pace
from rfpp.benchmark.repeated import Repeats, repeated
from rfpp.training.datamodule import SceneDataModule

#: The row's task and quantity.
LOADING = "loading"


@dataclass(frozen=True)
class LoaderAndStep:
    """Batches from shards by loader processes, and a training step on one of them.

    Attributes:
        data: what is loaded: made on the spot in a temporary folder, or stored.
        datamodule: (root, gbuffer_channels, workers) → what gives the batches.
        workers: loader processes.
        batches: that are timed at once.
        rounds: how often; the median is taken.
        network: its name in the benchmark's `networks`.
        size: of the network, by its name in conf/size.
        compiled: the transformer blocks.
        step: what a training step is.
    """

    data: InventedData | StoredData
    datamodule: Callable[..., SceneDataModule]
    workers: int
    batches: int
    rounds: int
    network: str
    size: str
    compiled: bool
    step: TrainingStep

    @property
    def identity(self) -> Row:
        """The columns that say what the row is about."""
        names = ("network", "size", "compiled", "workers")
        return {"task": LOADING, **{name: getattr(self, name) for name in names}}

    def row(
        self,
        compose: Callable[[list[str]], Mapping[str, Any]],
        networks: Mapping[str, Mapping[str, Any]],
        setting: Setting,
        repeats: Repeats,
    ) -> Row:
        """`seconds` are the loader's for a batch, `step_seconds` those of a step on the batch of median size.

        `of_step` is how many times as many images the loader delivers as the step consumes: above 1 the device does
        not wait for data. What else the processor has to do in training is not in it. The files were read before, so
        that the disk has no part in it.
        """
        model = compose([*networks[self.network]["overrides"], f"size={self.size}"])["model"]
        made = Untrained(str(networks[self.network]["name"]), model)
        channels = made("meta").gbuffer_channels
        with tempfile.TemporaryDirectory() as temporary:
            root = self.data.root(Path(temporary), lambda done, total: None)
            module = partial(self.datamodule, root=root, gbuffer_channels=channels, workers=self.workers)
            paces = [loader_pace(module(), self.batches, setting.where) for _ in range(self.rounds)]
        batch = _median_of(paces[0].batches)
        runs = repeated(made, self.step, batch, replace(setting, compile=self.compiled), repeats)
        [quantity] = runs.seconds
        return self._row(paces, batch, runs.median(quantity), runs.status)

    def _row(self, paces: Sequence[LoaderPace], batch: RaggedBatch, step: float | None, status: str) -> Row:
        scenes, views = len(batch.scenes), batch.num_views
        seconds = [pace.seconds / self.batches for pace in paces]
        loaded = scenes * views / median(seconds)
        return {
            **self.identity,
            "triangles": batch.objects.total // scenes,
            "objects": batch.scenes.total // scenes,
            "views": views,
            "resolution": batch.resolution[0],
            "scenes": scenes,
            "quantity": LOADING,
            "status": status,
            "runs": len(paces),
            "seconds": median(seconds),
            "seconds_min": min(seconds),
            "scenes_per_s": scenes / median(seconds),
            "images_per_s": loaded,
            "cpu_ms_per_image": 1e3 * median(p.cpu_seconds for p in paces) / (self.batches * scenes * views),
            "step_seconds": step,
            "step_images_per_s": scenes * views / step if step else None,
            "of_step": loaded * step / (scenes * views) if step else None,
        }


def _median_of(batches: Sequence[RaggedBatch]) -> RaggedBatch:
    return sorted(batches, key=lambda batch: batch.objects.total)[len(batches) // 2]
