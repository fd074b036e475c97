"""Shards → batches, for Lightning."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import lightning as L
from torch.utils.data import DataLoader

from rfpp.batch import RaggedBatch
from rfpp.errors import ShardError, UserError
from rfpp.shards.manifest import Manifest
from rfpp.shards.stream import ShardSplit
from rfpp.training.views import AllViews, ColourPermutation, GlobalBatches, RigidAugmentation, TrainingViews


class SceneDataModule(L.LightningDataModule):
    """Training batches of random views, and validation on unseen scenes.

    Args:
        root: folder of the data set.
        gbuffer_channels: what the network reads, in order.
        scenes_per_step: scenes in a global batch, over all devices.
        views_per_scene: views of each of them; scenes x views is the batch size the paper speaks of.
        training_scenes: use only the first so many scenes of the `train` split; None uses all.
        validation_scenes: how many scenes of the `validation` split to use at most.
        rigid_augmentation, colour_augmentation: of training draws, or None.
        workers: loader processes per device.
        seed: of data order, views and augmentation.
    """

    def __init__(
        self,
        root: str | Path,
        gbuffer_channels: Sequence[str],
        scenes_per_step: int,
        views_per_scene: int,
        training_scenes: int | None,
        validation_scenes: int,
        rigid_augmentation: RigidAugmentation | None,
        colour_augmentation: ColourPermutation | None,
        workers: int,
        seed: int,
    ):
        super().__init__()
        self.root, self.channels = Path(root), tuple(gbuffer_channels)
        self.scenes_per_step, self.views_per_scene = scenes_per_step, views_per_scene
        self.training_scenes, self.validation_scenes = training_scenes, validation_scenes
        self.rigid_augmentation, self.colour_augmentation = rigid_augmentation, colour_augmentation
        self.workers, self.seed = workers, seed

    @cached_property
    def manifest(self) -> Manifest:
        """Raises ShardError when there is no data set at `root`."""
        return Manifest.load(self.root)

    def train_dataloader(self) -> DataLoader:
        split = ShardSplit(self.root, "train")
        if len(split) == 0:
            raise ShardError(f"{self.root}: the train split is empty: generate data with data.splits.train above 0")
        trainer = self.trainer
        devices = trainer.world_size
        if self.scenes_per_step % devices:
            raise UserError(
                f"datamodule.scenes_per_step={self.scenes_per_step} does not divide among {devices} devices: "
                "choose a multiple"
            )
        batches = GlobalBatches(
            scenes=min(self.training_scenes or len(split), len(split)),
            seed=self.seed,
            scenes_per_batch=self.scenes_per_step,
            batches=trainer.max_steps * trainer.accumulate_grad_batches,
            rank=trainer.global_rank,
            ranks=devices,
        )
        views = TrainingViews(
            split, self.channels, self.views_per_scene, self.rigid_augmentation, self.colour_augmentation, self.seed
        )
        return self._loader(views, batch_sampler=batches)

    def val_dataloader(self) -> DataLoader:
        scenes = AllViews(ShardSplit(self.root, "validation"), self.channels)
        trainer = self.trainer
        mine = range(trainer.global_rank, min(self.validation_scenes, len(scenes)), trainer.world_size)
        return self._loader(scenes, batch_size=1, sampler=mine)

    def _loader(self, dataset, **how) -> DataLoader:
        return DataLoader(
            dataset,
            collate_fn=RaggedBatch.pack,
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            multiprocessing_context="spawn" if self.workers else None,
            pin_memory=self.trainer.strategy.root_device.type == "cuda",
            **how,
        )
