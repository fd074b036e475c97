"""How fast training data is read: the training loader against reading the same bytes and doing nothing with them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice, repeat
from pathlib import Path
from statistics import median

import webdataset

from rfpp.benchmark.invented import InventedData, StoredData
from rfpp.benchmark.loader_pace import Stopwatch, loader_pace
from rfpp.shards.index import SampleEntry
from rfpp.shards.manifest import Manifest
from rfpp.shards.order import ShuffledOrder
from rfpp.training.datamodule import SceneDataModule

Row = dict[str, str | int | float]

#: What the paper's training consumes on a node of 8 GPUs: 32 images per step of 1.2 s.
PAPER_IMAGES_PER_SECOND = 32 / 1.2


@dataclass(frozen=True)
class _DataSet:
    """A data set and what is read of it in one measurement."""

    manifest: Manifest
    batches: int
    scenes_per_batch: int
    seed: int

    @property
    def scenes(self) -> int:
        return self.batches * self.scenes_per_batch

    @property
    def entries(self) -> list[SampleEntry]:
        return self.manifest.samples("train")


def measure(
    data: Mapping[str, InventedData | StoredData],
    datamodule: Callable[..., SceneDataModule],
    workers: Sequence[int],
    batches: int,
    rounds: int,
    progress: Callable[[int, int], None],
) -> list[Row]:
    """A row per data set and way of reading; medians over rounds in which all of them take turns.

    The files were read before, so that the disk has no part in it. Starting loader processes is not counted. On a
    busy machine CPU time per scene says more than scenes per second.

    Args:
        data: by name.
        datamodule: (root, workers) → what gives the batches.
        workers: numbers of loader processes to try.
        batches: to time, each time.
        rounds: how often.
        progress: called with (measurements made, measurements in all).
    """
    rows = []
    for done, (name, source) in enumerate(data.items()):
        with tempfile.TemporaryDirectory() as temporary:
            root = source.root(Path(temporary), progress)
            ways = (2 + len(workers)) * rounds

            def made(count: int, before: int = done * ways, total: int = len(data) * ways) -> None:
                progress(before + count, total)

            rows += _rows(name, root, datamodule, workers, batches, rounds, made)
    return rows


def _rows(
    name: str,
    root: Path,
    datamodule: Callable[..., SceneDataModule],
    workers: Sequence[int],
    batches: int,
    rounds: int,
    made: Callable[[int], None],
) -> list[Row]:
    settings = datamodule(root=root, workers=0)
    data = _DataSet(Manifest.load(root), batches, settings.scenes_per_step, settings.seed)
    ways: dict[tuple[str, int], Callable[[], tuple[float, float]]] = {
        ("positioned reads", 0): lambda: _positioned(data),
        ("webdataset, undecoded", 0): lambda: _sequential(data),
        **{("training loader", n): lambda n=n: _loader(data, datamodule(root=root, workers=n)) for n in workers},
    }
    seconds: dict[tuple[str, int], list[tuple[float, float]]] = {way: [] for way in ways}
    for turn in range(rounds):
        for number, (way, run) in enumerate(ways.items(), start=1):
            seconds[way].append(run())
            made(turn * len(ways) + number)
    rates = {way: data.scenes / median(wall for wall, _ in times) for way, times in seconds.items()}
    cpu = {way: median(cpu for _, cpu in times) / data.scenes for way, times in seconds.items()}
    entries = data.entries
    megabytes = sum(entry.size for entry in entries) / len(entries) / 1e6
    rows = []
    for (reader, processes), scenes in rates.items():
        images = scenes * settings.views_per_scene
        rows.append(
            {
                "data": name,
                "resolution": data.manifest.settings["data"]["resolution"],
                "triangles": round(sum(entry.triangles for entry in entries) / len(entries)),
                "MB_per_scene": megabytes,
                "reader": reader,
                "workers": processes,
                "scenes_per_s": scenes,
                "images_per_s": images,
                "MB_per_s": scenes * megabytes,
                "cpu_ms_per_scene": 1e3 * cpu[reader, processes],
                "of_positioned_reads": scenes / rates["positioned reads", 0],
                "times_paper": images / PAPER_IMAGES_PER_SECOND,
            }
        )
    return rows


def _positioned(data: _DataSet) -> tuple[float, float]:
    """Wall and CPU seconds to read the samples' bytes in training's order, each from where the index says."""
    shards = data.manifest.shards("train")
    where = [(shard.file, entry) for shard in shards for entry in data.manifest.index(shard).samples]
    files = {shard.file: os.open(data.manifest.root / shard.file, os.O_RDONLY) for shard in shards}
    order = ShuffledOrder([shard.samples for shard in shards], data.seed, window=len(shards))
    watch = Stopwatch()
    for _, index in islice(order.draws(), data.scenes):
        file, entry = where[index]
        os.pread(files[file], entry.size, entry.offset)
    elapsed = watch.read()
    for descriptor in files.values():
        os.close(descriptor)
    return elapsed


def _sequential(data: _DataSet) -> tuple[float, float]:
    """Wall and CPU seconds to take the samples' bytes out of the tars, one after the other."""
    urls = [str(data.manifest.root / shard.file) for shard in data.manifest.shards("train")]
    watch = Stopwatch()
    for _ in islice(_endless(urls), data.scenes):
        pass
    return watch.read()


def _endless(urls: list[str]) -> Iterator[dict]:
    return chain.from_iterable(webdataset.WebDataset(tars, shardshuffle=False) for tars in repeat(urls))


def _loader(data: _DataSet, datamodule: SceneDataModule) -> tuple[float, float]:
    """Wall and CPU seconds of the training loader."""
    pace = loader_pace(datamodule, data.batches)
    return pace.seconds, pace.cpu_seconds
