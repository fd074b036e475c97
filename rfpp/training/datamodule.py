"""Shards → batches, for Lightning."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Mapping, Sequence
from multiprocessing.context import BaseContext
from typing import Any

import lightning as L
import torch
from torch.utils.data import DataLoader

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.shards.manifest import Manifest
from rfpp.shards.views import AllViews
from rfpp.training.augmentation import Augmentation
from rfpp.training.batching import Batching
from rfpp.training.loader import Packing, SceneLoader
from rfpp.training.readers import Reader
from rfpp.training.signals import exit_with_parent
from rfpp.training.source import DataSource
from rfpp.training.views import Share, TrainingViews


def loader_processes() -> BaseContext:
    """Return the context of loader processes.

    They are forks of a server that imports this module once: importing takes seconds, and hundreds of megabytes that
    all processes share. The training process itself has threads and a GPU, and cannot be forked. On macOS, whose system
    libraries do not survive a fork, each imports for itself.
    """
    context = multiprocessing.get_context("spawn" if sys.platform == "darwin" else "forkserver")
    context.set_forkserver_preload([__name__])
    return context


class SceneDataModule(L.LightningDataModule):
    """Training batches of random views, and validation on unseen scenes.

    Its state is the position in the data order: with `IndexedReader`, a resumed run reads no scene twice in an epoch.

    Args:
        gbuffer_channels: Channels that the network reads, in order.
        padded: Whether to round training batches up to recurring sizes, see `RaggedBatch.padded`.
        augmentation: Name → augmentation of training draws, applied in this order; None disables one.
    """

    def __init__(
        self,
        source: DataSource,
        reader: Reader,
        batching: Batching,
        gbuffer_channels: Sequence[str],
        augmentation: Mapping[str, Augmentation | None],
        workers: int,
        seed: int,
        padded: bool = False,
    ):
        super().__init__()
        self.source, self.reader, self.batching = source, reader, batching
        self.channels = tuple(gbuffer_channels)
        self.augmentations = [one for one in augmentation.values() if one is not None]
        self.workers, self.seed, self.padded = workers, seed, padded
        self._steps_before = 0

    @property
    def manifest(self) -> Manifest:
        """Manifest of the data; raises ShardError like `DataSource.manifest`."""
        return self.source.manifest

    @property
    def scenes_per_batch(self) -> int:
        """Scenes per device and batch, if all are readable."""
        return self.batching.scenes_per_step // (self.trainer.world_size * self.trainer.accumulate_grad_batches)

    def train_dataloader(self) -> DataLoader:
        split, trainer, batching = self.source.training(), self.trainer, self.batching
        views = TrainingViews(split, self.channels, batching.views_per_scene, self.augmentations, self.seed)
        share = Share(
            steps=trainer.max_steps,
            start=self._steps_before,
            rank=trainer.global_rank,
            ranks=trainer.world_size,
            accumulate=trainer.accumulate_grad_batches,
        )
        options = self.reader(views, self.source, batching, share, self.workers)
        return self._loader(collate_fn=Packing(self.padded), **options)

    def val_dataloader(self) -> DataLoader:
        scenes, trainer = AllViews(self.source.validation(), self.channels), self.trainer
        mine = range(trainer.global_rank, min(self.source.validation_scenes, len(scenes)), trainer.world_size)
        return self._loader(dataset=scenes, collate_fn=RaggedBatch.pack, batch_size=1, sampler=mine)

    def state_dict(self) -> dict[str, Any]:
        """Return the order and training's position in it; the loader itself is ahead, because it prefetches."""
        return {"order": self._order, "steps": self.trainer.global_step}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue from the state, on any number of devices. Raises UserError if the order differs."""
        for name, before in state_dict["order"].items():
            if before != self._order.get(name):
                raise UserError(
                    f"the run to resume had {name}={before}, this one {self._order.get(name)}, which changes the order "
                    f"of its batches: set {name}={before}, or start a new run from its weights (initial_weights)"
                )
        self._steps_before = state_dict["steps"]

    @property
    def _order(self) -> dict[str, Any]:
        """All settings that determine the global batches."""
        return {
            "seed": self.seed,
            "datamodule.reader": self.reader.name,
            "datamodule.batching.scenes_per_step": self.batching.scenes_per_step,
            "datamodule.source.training_scenes": self.source.training_scenes,
            "datamodule.batching.shuffle_shards": self.batching.shuffle_shards,
            "data manifest": self.manifest.hash,
        }

    def _loader(self, **options: Any) -> DataLoader:
        return SceneLoader(
            num_workers=self.workers,
            # separate from training's generator: its state would depend on how often the run was resumed
            generator=torch.Generator().manual_seed(self.seed),
            persistent_workers=self.workers > 0,
            multiprocessing_context=loader_processes() if self.workers else None,
            worker_init_fn=exit_with_parent,
            pin_memory=self.trainer.strategy.root_device.type == "cuda",
            **options,
        )
