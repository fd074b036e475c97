"""Measure the speed of loading training data."""

from __future__ import annotations

import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import lightning as L
import psutil

from rfpp.benchmark.csv_rows import Row
from rfpp.reference.farm import RenderFarm
from rfpp.reference.labels import LabelSource
from rfpp.shards.generation import generate
from rfpp.shards.job import DatasetSettings, SceneSource
from rfpp.shards.manifest import Manifest
from rfpp.shards.recipe import Recipe
from rfpp.training.datamodule import SceneDataModule
from rfpp.training.source import DataSource

#: Images per second of the paper's training on a node of 8 GPUs: 32 images in a step of 1.2 s.
PAPER_IMAGES_PER_SECOND = 32 / 1.2

#: Batches that each loader process prepares in advance.
_PREFETCHED = 2

#: Wall and CPU seconds, the latter with those of child processes.
Seconds = tuple[float, float]


def measure(
    data: Mapping[str, SyntheticData | str],
    source: Callable[..., DataSource],
    datamodule: Callable[..., SceneDataModule],
    workers: Sequence[int],
    batches: int,
    rounds: int,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Yield a row per data set and number of loader processes; medians over rounds in which all numbers take turns.

    The files are in the page cache, so the disk is not measured; starting loader processes is not counted. On a busy
    machine, CPU time per scene is more reliable than scenes per second.
    """
    done, total = 0, len(data) * rounds * len(workers)
    for name, origin in data.items():
        with tempfile.TemporaryDirectory() as temporary:
            root = Path(temporary if isinstance(origin, SyntheticData) else origin)
            if isinstance(origin, SyntheticData):
                origin.write(root, lambda done, total: None)
            modules = {count: datamodule(source=source(root=root), workers=count) for count in workers}
            seconds: dict[int, list[Seconds]] = {count: [] for count in workers}
            for _ in range(rounds):
                for count, module in modules.items():
                    seconds[count].append(load(module, batches))
                    done += 1
                    progress(done, total)
            manifest = Manifest.load(root)
            for count, module in modules.items():
                scenes = batches * module.batching.scenes_per_step
                yield {"data": name, **_figures(manifest, module, scenes, seconds[count])}


def _figures(manifest: Manifest, datamodule: SceneDataModule, scenes: int, seconds: Sequence[Seconds]) -> Row:
    entries = manifest.samples("train")
    megabytes = sum(entry.size for entry in entries) / len(entries) / 1e6
    rate = scenes / median(wall for wall, _ in seconds)
    images = rate * datamodule.batching.views_per_scene
    return {
        "resolution": manifest.settings["data"]["resolution"],
        "triangles": round(sum(entry.triangles for entry in entries) / len(entries)),
        "MB_per_scene": megabytes,
        "workers": datamodule.workers,
        "scenes_per_s": rate,
        "images_per_s": images,
        "MB_per_s": rate * megabytes,
        "cpu_ms_per_scene": 1e3 * median(cpu for _, cpu in seconds) / scenes,
        "times_paper": images / PAPER_IMAGES_PER_SECOND,
    }


def load(datamodule: SceneDataModule, batches: int) -> Seconds:
    """Load batches while every loader process has work before and after."""
    ahead = 1 + _PREFETCHED * datamodule.workers
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        datamodule.trainer = L.Trainer(
            max_steps=batches + 2 * ahead, accelerator="cpu", devices=1, logger=False, enable_checkpointing=False,
            enable_progress_bar=False,
        )  # fmt: skip
        loader = iter(datamodule.train_dataloader())
        for _ in range(ahead):
            next(loader)
        begin = _now()
        for _ in range(batches):
            next(loader)
        elapsed = _since(begin)
        for _ in loader:  # PyTorch's processes may abort if they are stopped while they send
            pass
    return elapsed


def _now() -> Seconds:
    this = psutil.Process()
    times = [process.cpu_times() for process in (this, *this.children(recursive=True))]
    return time.perf_counter(), sum(t.user + t.system for t in times)


def _since(begin: Seconds) -> Seconds:
    wall, cpu = _now()
    return wall - begin[0], cpu - begin[1]


@dataclass(frozen=True)
class SyntheticData:
    """First training scenes of a family, with images that need no Blender."""

    family: SceneSource
    data: DatasetSettings
    reference: LabelSource
    farm: RenderFarm
    scenes: int

    def write(self, folder: Path, progress: Callable[[int, int], None]) -> None:
        """Write the data set into a folder."""
        data = replace(self.data, name="synthetic", root=str(folder), splits={"train": self.scenes})
        recipe = Recipe.of_scenes(self.family, self.reference, data, {})
        with self.farm as farm:
            generate(recipe, farm, progress)
