"""Training of radiosity's refinement on images that radiosity renders."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import lightning as L
import numpy as np
import torch
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler
from torch.utils.data import Dataset

from rfpp.imaging.radiance import log_encode
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.renderer import Renderer
from rfpp.losses.log_l1 import log_l1
from rfpp.radiosity.refinement import Refinement
from rfpp.radiosity.sample_means import means
from rfpp.raycast.first_hit import CHANNELS
from rfpp.scene.packed import PackedScene
from rfpp.shards.dataset import ShardSplit

#: A view without a batch dimension: linear `radiance` and `reference` [3, H, W], `surfaces` [13, H, W] of
#: `Refinement.channels`, and `fov` [], in half precision. With a batch dimension, it is a batch.
View = dict[str, Tensor]


def render_views(
    renderer: Renderer,
    split: ShardSplit,
    samplings: Sequence[Sequence[int]],
    seed: int,
    scenes: int | None,
    progress: Callable[[int, int], None],
) -> list[View]:
    """Render the views of stored scenes without refinement.

    Args:
        samplings: Pairs of light samples and supersampling; one is drawn for each view.
        progress: Called with the scenes rendered so far and the number of scenes.
    """
    rng, surfaces = np.random.default_rng(seed), GBufferSource(Refinement.channels)
    count, views = min(scenes or len(split), len(split)), []
    for index in range(count):
        progress(index, count)
        sample = split.read(index, None, ())
        size = sample.images.shape[1:3]
        for view, reference in enumerate(sample.images):
            light_samples, points = samplings[rng.integers(len(samplings))]
            scene = PackedScene(sample.key, sample.triangles, sample.c2w, sample.fov).views([view])
            [radiance] = renderer.views(scene, size, None, light_samples, points, is_refined=False)
            samples = torch.from_numpy(surfaces.of(scene, *size, light_samples=1, points=points)(0))
            rendered = {
                "radiance": torch.from_numpy(radiance).permute(2, 0, 1),
                "reference": torch.from_numpy(reference).permute(2, 0, 1),
                "surfaces": means(samples[None], points)[0],
                "fov": torch.tensor(scene.fov[0]),
            }
            views.append({name: value.half().contiguous() for name, value in rendered.items()})
    progress(count, count)
    return views


def augment(view: View, generator: torch.Generator) -> View:
    """Permute the color channels of a view, and mirror every second one."""
    colors, is_mirrored = torch.randperm(3, generator=generator), torch.rand((), generator=generator) < 0.5
    albedo, specular, roughness, normal, position = view["surfaces"].split([CHANNELS[n] for n in Refinement.channels])
    if is_mirrored:
        mirror = torch.tensor([-1.0, 1.0, 1.0])[:, None, None].to(normal)
        normal, position = mirror * normal, mirror * position
    images = {
        "radiance": view["radiance"][colors],
        "reference": view["reference"][colors],
        "surfaces": torch.cat([albedo[colors], specular[colors], roughness, normal, position]),
    }
    return view | {name: image.flip(-1) if is_mirrored else image for name, image in images.items()}


class AugmentedViews(Dataset):
    """Views that are augmented differently at each draw."""

    def __init__(self, views: Sequence[View], seed: int):
        self.views, self._generator = views, torch.Generator().manual_seed(seed)

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, index: int) -> View:
        return augment(self.views[index], self._generator)


class RefinementModule(L.LightningModule):
    """Refinement, loss and logging."""

    def __init__(
        self,
        refinement: Refinement,
        loss: Callable[[Tensor, Tensor], Tensor],
        optimizer: Callable[[Iterable[torch.nn.Parameter]], Optimizer],
        schedule: Callable[[Optimizer], LRScheduler],
    ):
        super().__init__()
        self.refinement, self._loss, self._optimizer, self._schedule = refinement, loss, optimizer, schedule

    def training_step(self, batch: View, _: int) -> Tensor:
        loss = self._loss(self._refined(batch), batch["reference"].float())
        self.log("train/loss", loss.detach())
        return loss

    def validation_step(self, batch: View, _: int) -> None:
        images = {"log_l1": self._refined(batch), "unrefined_log_l1": batch["radiance"].float()}
        for name, image in images.items():
            error = log_l1(log_encode(image), batch["reference"].float())
            self.log(f"validation/{name}", error, batch_size=len(image))

    def configure_optimizers(self) -> dict[str, Any]:
        optimizer = self._optimizer(self.refinement.parameters())
        return {"optimizer": optimizer, "lr_scheduler": {"scheduler": self._schedule(optimizer), "interval": "step"}}

    def _refined(self, batch: View) -> Tensor:
        refined: Tensor = self.refinement(batch["radiance"].float(), batch["surfaces"].float(), batch["fov"].float())
        return refined
