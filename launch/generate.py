"""Make a data set: random scenes → Blender Cycles and G-buffers → WebDataset shards.

    python launch/generate.py +experiment=quickstart

Run the same command again after an interruption: finished shards are kept.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn

from rfpp.entry import entry_point
from rfpp.errors import UserError
from rfpp.shards.generation import generate
from rfpp.shards.job import DatasetSettings
from rfpp.shards.manifest import Manifest


@entry_point("generate")
def main(cfg: DictConfig) -> Manifest:
    """Make what is missing of the data set `cfg.data`; returns its manifest."""
    console = Console()
    data: DatasetSettings = instantiate(cfg.data, _convert_="all")
    settings = {group: OmegaConf.to_container(cfg[group], resolve=True) for group in ("scene", "reference")}
    console.print(f"Data set '{data.name}' → {data.root}", highlight=False, soft_wrap=True)
    begin = time.perf_counter()
    try:
        with _bar(console, data.views) as bar:
            manifest = generate(instantiate(cfg.scene), instantiate(cfg.reference), data, settings, bar.show)
    except KeyboardInterrupt:
        raise UserError("interrupted: run the same command again to go on, finished scenes are kept") from None
    if bar.made == 0:
        console.print(
            f"Nothing to do: all {manifest.counts['scenes']} scenes are there.", highlight=False, soft_wrap=True
        )
    else:
        console.print(_summary(manifest, bar.made, time.perf_counter() - begin), highlight=False, soft_wrap=True)
    return manifest


class _ImageBar:
    """A progress bar that counts images, shown if any are missing."""

    def __init__(self, progress: Progress, views: int) -> None:
        self._progress = progress
        self._views = views
        self._task = None
        self._done_before = 0
        self.made = 0

    def show(self, done: int, total: int) -> None:
        if self._task is None:
            self._done_before = done
            images = {"total": total * self._views, "before": done * self._views}
            self._task = self._progress.add_task("images", visible=done < total, **images)
        self.made = done - self._done_before
        self._progress.update(self._task, completed=done * self._views)


class _ImagesPerSecond(ProgressColumn):
    def render(self, task: Task) -> str:
        made = task.completed - task.fields["before"]
        return f"{made / task.elapsed:.1f} images/s" if made and task.elapsed else "starting"


@contextmanager
def _bar(console: Console, views: int) -> Iterator[_ImageBar]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _ImagesPerSecond())
    with Progress(*columns, TimeRemainingColumn(), console=console) as progress:
        yield _ImageBar(progress, views)


def _summary(manifest: Manifest, made: int, seconds: float) -> str:
    counts = manifest.counts
    return (
        f"Made {made} scenes in {seconds:.0f} s. In all: {counts['scenes']} scenes, {counts['images']} images, "
        f"{counts['triangles']} triangles, {counts['bytes'] / 1e6:.0f} MB; redrawn: {counts['scene_redraws']} scenes, "
        f"{counts['empty_views']} views of too little surface, {counts['unlit_views']} of too little light.\n"
        f"Manifest {manifest.hash[:12]}: {manifest.root}/manifest.json"
    )


if __name__ == "__main__":
    main()
