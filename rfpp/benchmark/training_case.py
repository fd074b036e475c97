"""What a benchmark of training trains: an experiment, without its data set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from hydra import compose
from hydra.utils import instantiate

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.benchmark.cost.case import noise
from rfpp.benchmark.step_time import Work
from rfpp.losses.rendering import RenderingLoss
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.scene.packed import pack
from rfpp.shards.job import SceneSource
from rfpp.training.dealing import Dealing
from rfpp.training.flops import training_flops

#: Of the sampled scenes so many have their operations counted; the others' lie on a line over triangles.
COUNTED = 3


@dataclass(frozen=True)
class Training:
    """What is trained, and on what: an experiment without its data set.

    Attributes:
        network, loss, optimizer: makers of each, the last from parameters.
        family: of scenes, whose triangles are all that matters.
        resolution, views: of a scene's images.
        scenes, scenes_at_once: of a global batch, and what a device holds of it (None: its whole share).
        sample: how many scenes stand for the family; at least twice a global batch where steps are timed.
    """

    network: Callable[[], RenderFormerPP]
    loss: Callable[[], RenderingLoss]
    optimizer: Callable[..., torch.optim.Optimizer]
    family: SceneSource
    resolution: int
    views: int
    scenes: int
    scenes_at_once: int | None
    sample: int

    @classmethod
    def of(cls, overrides: Sequence[str], sample: int) -> Training:
        """What launch/train.py would train, given these overrides. To be called in a Hydra application."""
        cfg = compose("train", overrides=list(overrides))
        return cls(
            network=partial(instantiate, cfg.model, _convert_="all"),
            loss=partial(instantiate, cfg.loss),
            optimizer=instantiate(cfg.optimizer),
            family=instantiate(cfg.family, _convert_="all"),
            resolution=cfg.data.resolution,
            views=cfg.datamodule.views_per_scene,
            scenes=cfg.datamodule.scenes_per_step,
            scenes_at_once=cfg.datamodule.scenes_per_device,
            sample=sample,
        )

    def scene_views(self) -> list[SceneViews]:
        """The family's first scenes, with noise for images and G-buffers."""
        channels = self.network().gbuffer_channels
        return [self._noisy(np.random.default_rng(i), channels) for i in range(self.sample)]

    def _noisy(self, rng: np.random.Generator, channels: Sequence[str]) -> SceneViews:
        scene = pack(self.family.sample(*rng.spawn(2), held_out=False))
        scene = scene.views([i % len(scene.fov) for i in range(self.views)])
        invented = noise(channels, scene.triangles.num_objects, self.views, self.resolution, rng)
        return SceneViews("", scene.triangles, scene.c2w, scene.fov, **invented)

    def work(self, scenes: Sequence[SceneViews], dealing: Dealing) -> Work:
        """Of a step on these scenes."""
        network = self.network()
        triangles = np.array([len(s.triangles.positions) for s in scenes])
        counted = np.argsort(triangles)[np.linspace(0, len(scenes) - 1, COUNTED).astype(int)]
        with torch.autocast("cpu", torch.bfloat16):
            flops = [training_flops(network, RaggedBatch.pack([scenes[i]])) for i in counted]
        line = np.polynomial.Polynomial.fit(triangles[counted], flops, 1)
        size = float(sum(p.numel() * p.element_size() for p in network.parameters()))
        return Work(triangles, line(triangles), size, self.scenes, self.scenes_at_once, dealing, self.views)
