"""Data loaders, and handling of unreadable scenes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from torch.utils.data import DataLoader, Dataset

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.errors import ShardError, UserError
from rfpp.training.signals import loaders_protected


class SceneLoader(DataLoader):
    """A DataLoader whose processes ignore stop signals until training has stopped.

    User errors of its processes keep their one-line message instead of a traceback.
    """

    def __iter__(self) -> Iterator[Any]:
        with loaders_protected():
            batches = super().__iter__()
        try:
            yield from batches
        except UserError as error:
            _, in_worker, traceback = str(error).partition("Original Traceback")
            if not in_worker:
                raise
            last_line = traceback.strip().splitlines()[-1]  # "rfpp.errors.ShardError: message"
            raise type(error)(last_line.partition(": ")[2]) from error


class SkippingCorrupt(Dataset):
    """A dataset that returns None for damaged scenes, with a warning per process and scene.

    Args:
        scenes: Raises ShardError naming shard and scene for an unreadable scene.
    """

    def __init__(self, scenes: Dataset):
        self.scenes = scenes

    def __getitem__(self, draw: Any) -> SceneViews | None:
        try:
            return self.scenes[draw]
        except ShardError as error:
            warnings.warn(f"skipped: {error}", stacklevel=2)  # Python shows equal warnings once
            return None


class Packing:
    """Collation of the readable scenes of a batch.

    A batch without any repeats the one before, without keys: its weight in training is zero, and no rank misses a step.

    Args:
        padded: Whether to round sizes up to those that recur.

    Raises:
        ShardError: If no scene of the first batch of a loader process can be read.
    """

    def __init__(self, padded: bool):
        self.padded = padded
        self._before: RaggedBatch | None = None

    def __call__(self, scenes: Sequence[SceneViews | None]) -> RaggedBatch:
        if readable := [scene for scene in scenes if scene is not None]:
            batch = RaggedBatch.pack(readable)
            self._before = batch.padded() if self.padded else batch
            return self._before
        if self._before is None:
            raise ShardError(f"none of a batch's {len(scenes)} scenes can be read: see the warnings above")
        return replace(self._before, keys=())
