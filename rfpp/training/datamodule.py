"""Shards → batches, for Lightning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import lightning as L
import torch
from torch.utils.data import DataLoader

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.shards.manifest import Manifest
from rfpp.shards.order import ShuffledOrder, truncated
from rfpp.shards.views import AllViews
from rfpp.training.augmentation import Augmentation
from rfpp.training.batching import Batching
from rfpp.training.loader import Packing, SceneLoader, SkippingCorrupt
from rfpp.training.signals import exit_with_parent
from rfpp.training.source import DataSource
from rfpp.training.views import GlobalBatches, TrainingViews


class SceneDataModule(L.LightningDataModule):
    """Training batches of random views, and validation on unseen scenes.

    Its state is the position in the data order: a resumed run reads no scene twice in an epoch.

    Args:
        gbuffer_channels: Channels that the network reads, in order.
        padded: Whether to round training batches up to recurring sizes, see `RaggedBatch.padded`.
        augmentation: Name → augmentation of training draws, applied in this order; None disables one.
    """

    def __init__(
        self,
        source: DataSource,
        batching: Batching,
        gbuffer_channels: Sequence[str],
        augmentation: Mapping[str, Augmentation | None],
        workers: int,
        seed: int,
        padded: bool = False,
    ):
        super().__init__()
        self.source, self.batching, self.channels = source, batching, tuple(gbuffer_channels)
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
        split, trainer = self.source.training(), self.trainer
        sizes = truncated(split.sizes, self.source.training_scenes or len(split))
        batches = GlobalBatches(
            ShuffledOrder(sizes, self.seed, self.batching.shuffle_shards),
            self.batching.partition,
            lambda draw: self.source.triangles(split, draw[1]),
            scenes_per_batch=self.batching.scenes_per_step,
            batches=trainer.max_steps,
            start=self._steps_before,
            rank=trainer.global_rank,
            ranks=trainer.world_size,
            accumulate=trainer.accumulate_grad_batches,
        )
        views = TrainingViews(split, self.channels, self.batching.views_per_scene, self.augmentations, self.seed)
        scenes = SkippingCorrupt(views) if self.source.skip_corrupt else views
        return self._loader(scenes, Packing(self.padded), batch_sampler=batches)

    def val_dataloader(self) -> DataLoader:
        scenes, trainer = AllViews(self.source.validation(), self.channels), self.trainer
        mine = range(trainer.global_rank, min(self.source.validation_scenes, len(scenes)), trainer.world_size)
        return self._loader(scenes, RaggedBatch.pack, batch_size=1, sampler=mine)

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
            "datamodule.batching.scenes_per_step": self.batching.scenes_per_step,
            "datamodule.source.training_scenes": self.source.training_scenes,
            "datamodule.batching.shuffle_shards": self.batching.shuffle_shards,
            "data manifest": self.manifest.hash,
        }

    def _loader(self, dataset, collate, **options) -> DataLoader:
        return SceneLoader(
            dataset,
            collate_fn=collate,
            num_workers=self.workers,
            # separate from training's generator: its state would depend on how often the run was resumed
            generator=torch.Generator().manual_seed(self.seed),
            persistent_workers=self.workers > 0,
            multiprocessing_context="spawn" if self.workers else None,
            worker_init_fn=exit_with_parent,
            pin_memory=self.trainer.strategy.root_device.type == "cuda",
            **options,
        )
