"""Data loaders, and handling of unreadable scenes."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
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


def pack_readable(scenes: Sequence[SceneViews | None]) -> RaggedBatch:
    """Collate the readable scenes into a batch. Raises ShardError if there are none."""
    readable = [scene for scene in scenes if scene is not None]
    if not readable:
        raise ShardError(f"none of a batch's {len(scenes)} scenes can be read: see the warnings above")
    return RaggedBatch.pack(readable)


def pack_padded(scenes: Sequence[SceneViews | None]) -> RaggedBatch:
    """Collate like `pack_readable`, into sizes that recur."""
    return pack_readable(scenes).padded()
