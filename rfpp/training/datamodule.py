"""Shards → batches, for Lightning."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import lightning as L
import torch
from torch.utils.data import DataLoader

from rfpp.batch import RaggedBatch
from rfpp.errors import ShardError, UserError
from rfpp.shards.cache import ShardCache
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.joined import JoinedManifest, JoinedSplit, Root, open_manifest, open_split
from rfpp.shards.manifest import Manifest
from rfpp.shards.order import ShuffledOrder, leading
from rfpp.shards.views import AllViews
from rfpp.training.augmentation import ColourPermutation, RigidAugmentation
from rfpp.training.dealing import Dealing
from rfpp.training.loader import SceneLoader, SkippingCorrupt, pack_readable
from rfpp.training.parentage import end_with_parent
from rfpp.training.views import GlobalBatches, TrainingViews


class SceneDataModule(L.LightningDataModule):
    """Training batches of random views, and validation on unseen scenes.

    Its state is the position in the data's order: what goes on from a checkpoint reads nothing that was trained on.

    Args:
        root: folder or URL of the data set, or of several that are trained on together; one named twice counts twice.
        cache: where a remote data set is fetched to.
        gbuffer_channels: what the network reads, in order.
        scenes_per_step: scenes in a global batch, over all devices.
        scenes_per_device: scenes that a device holds at once, at most; the rest of its share of the global batch comes
            after, with gradients accumulated. None: its whole share at once.
        dealing: which device gets which scenes of a global batch.
        views_per_scene: views of each of them; scenes x views is the batch size the paper speaks of.
        training_scenes: use only the first so many scenes of the `train` split; None uses all.
        validation_scenes: how many scenes of the `validation` split to use at most.
        shuffle_shards: so many shards are mixed at a time.
        skip_corrupt: leave a training scene that cannot be read out of its batch, with a warning, instead of
            stopping. Validation always stops: its numbers are compared.
        rigid_augmentation, colour_augmentation: of training draws, or None.
        workers: loader processes per device.
        seed: of data order, views and augmentation.
    """

    def __init__(
        self,
        root: Root | Sequence[Root],
        cache: ShardCache,
        gbuffer_channels: Sequence[str],
        scenes_per_step: int,
        scenes_per_device: int | None,
        dealing: Dealing,
        views_per_scene: int,
        training_scenes: int | None,
        validation_scenes: int,
        shuffle_shards: int,
        skip_corrupt: bool,
        rigid_augmentation: RigidAugmentation | None,
        colour_augmentation: ColourPermutation | None,
        workers: int,
        seed: int,
    ):
        super().__init__()
        self.root, self.cache, self.channels = root, cache, tuple(gbuffer_channels)
        self.scenes_per_step, self.scenes_per_device = scenes_per_step, scenes_per_device
        self.dealing, self.views_per_scene = dealing, views_per_scene
        self.training_scenes, self.validation_scenes = training_scenes, validation_scenes
        self.shuffle_shards, self.skip_corrupt = shuffle_shards, skip_corrupt
        self.rigid_augmentation, self.colour_augmentation = rigid_augmentation, colour_augmentation
        self.workers, self.seed = workers, seed
        self._steps_before = 0

    @cached_property
    def manifest(self) -> Manifest | JoinedManifest:
        """Raises ShardError when there is no data set at `root`, or several do not fit together."""
        return open_manifest(self.root, self.cache)

    def accumulation(self, devices: int) -> int:
        """Batches to accumulate per device and step; as few as fit.

        Raises:
            UserError: the global batch does not divide among the devices.
        """
        share, left = divmod(self.scenes_per_step, devices)
        if left or not share:
            raise UserError(
                f"datamodule.scenes_per_step={self.scenes_per_step} does not divide among {devices} devices "
                "(trainer.devices x trainer.num_nodes): choose a multiple"
            )
        most = share if self.scenes_per_device is None else self.scenes_per_device
        if most < 1:
            raise UserError(
                f"datamodule.scenes_per_device={most}: a device must hold a scene at least, or null for all"
            )
        return next(n for n in range(1, share + 1) if share % n == 0 and share // n <= most)

    @property
    def scenes_per_batch(self) -> int:
        """Scenes per device and batch, if all are readable."""
        return self.scenes_per_step // (self.trainer.world_size * self.trainer.accumulate_grad_batches)

    def train_dataloader(self) -> DataLoader:
        split = open_split(self.root, "train", self.cache, require_all=not self.skip_corrupt)
        if len(split) == 0:
            raise ShardError(f"{self.root}: the train split is empty: generate data with data.splits.train above 0")
        trainer = self.trainer
        batches = GlobalBatches(
            ShuffledOrder(leading(split.sizes, self.training_scenes or len(split)), self.seed, self.shuffle_shards),
            self.dealing,
            lambda draw: self._triangles(split, draw[1]),
            scenes_per_batch=self.scenes_per_step,
            batches=trainer.max_steps,
            start=self._steps_before,
            rank=trainer.global_rank,
            ranks=trainer.world_size,
            accumulate=trainer.accumulate_grad_batches,
        )
        views = TrainingViews(
            split,
            self.channels,
            self.views_per_scene,
            self.rigid_augmentation,
            self.colour_augmentation,
            self.seed,
        )
        if self.skip_corrupt:
            return self._loader(SkippingCorrupt(views), pack_readable, batch_sampler=batches)
        return self._loader(views, RaggedBatch.pack, batch_sampler=batches)

    def val_dataloader(self) -> DataLoader:
        scenes = AllViews(open_split(self.root, "validation", self.cache), self.channels)
        trainer = self.trainer
        mine = range(trainer.global_rank, min(self.validation_scenes, len(scenes)), trainer.world_size)
        return self._loader(scenes, RaggedBatch.pack, batch_size=1, sampler=mine)

    def state_dict(self) -> dict[str, Any]:
        """The order and the position of training in it; the loader is ahead, because its processes prefetch."""
        return {"order": self._order, "steps": self.trainer.global_step}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue from the state, on any number of devices. Raises UserError if the order differs."""
        for name, before in state_dict["order"].items():
            if before != self._order[name]:
                raise UserError(
                    f"the run to resume had {name}={before}, this one {self._order[name]}, which gives its batches in "
                    f"another order: set it so, or start anew from its weights (initial_weights)"
                )
        self._steps_before = state_dict["steps"]

    @property
    def _order(self) -> dict[str, Any]:
        """All settings that determine the global batches."""
        return {
            "seed": self.seed,
            "datamodule.scenes_per_step": self.scenes_per_step,
            "datamodule.training_scenes": self.training_scenes,
            "datamodule.shuffle_shards": self.shuffle_shards,
            "data manifest": self.manifest.hash,
        }

    def _triangles(self, split: ShardSplit | JoinedSplit, scene: int) -> int:
        """Triangles of a scene; 0 if its index is unreadable, since the loader then skips it."""
        try:
            return split.triangles(scene)
        except ShardError:
            if not self.skip_corrupt:
                raise
            return 0

    def _loader(self, dataset, collate, **how) -> DataLoader:
        return SceneLoader(
            dataset,
            collate_fn=collate,
            num_workers=self.workers,
            # not training's generator: how often loaders are begun depends on how often the run was
            generator=torch.Generator().manual_seed(self.seed),
            persistent_workers=self.workers > 0,
            multiprocessing_context="spawn" if self.workers else None,
            worker_init_fn=end_with_parent,
            pin_memory=self.trainer.strategy.root_device.type == "cuda",
            **how,
        )
