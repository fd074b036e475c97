"""Predict the views of a stored scene by a network, a renderer or a baseline."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.evaluation.measuring.records import MODEL
from rfpp.imaging.radiance import log_decode
from rfpp.inference.network_engine import NetworkEngine
from rfpp.inference.renderer import Renderer
from rfpp.metrics import baselines, l1_parts
from rfpp.raycast.first_hit import CHANNELS
from rfpp.scene.packed import PackedScene
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.sample import SceneSample
from rfpp.shards.views import select_views

#: G-buffer channels that baselines and detailed metrics read.
_CHANNELS = (*baselines.CHANNELS, *l1_parts.CHANNELS)


@dataclass(frozen=True, eq=False)
class StoredScene:
    """A stored scene with all its views.

    Attributes:
        reference: Linear radiance of the reference images, [V, 3, H, W].
        gbuffer: Channels that baselines and detailed metrics read, [V, 3 or 1, H, W] each.
    """

    sample: SceneSample
    reference: Float[Tensor, "v 3 h w"]
    gbuffer: dict[str, Float[Tensor, "v _ h w"]]

    @classmethod
    def of(cls, sample: SceneSample, device: torch.device) -> StoredScene:
        """Move a sample to a device."""
        views = select_views(sample, range(len(sample.fov)), _CHANNELS)
        gbuffer = torch.from_numpy(views.gbuffer).to(device).split([CHANNELS[name] for name in _CHANNELS], dim=1)
        return cls(sample, torch.from_numpy(views.image).to(device), dict(zip(_CHANNELS, gbuffer, strict=True)))


class Predictor(ABC):
    """Anything that predicts the views of a stored scene."""

    name: str

    @abstractmethod
    def predict(self, scene: StoredScene) -> Float[Tensor, "v 3 h w"]:
        """Predict linear radiance."""


class NetworkPredictor(Predictor):
    """A network on the stored G-buffers."""

    name = MODEL

    def __init__(self, network: nn.Module, device: torch.device):
        self.network, self.device = network, device

    def predict(self, scene: StoredScene) -> Float[Tensor, "v 3 h w"]:
        """Predict linear radiance.

        Raises:
            UserError: If the stored resolution is not divisible by the network's patch size.
        """
        height, width = scene.reference.shape[-2:]
        if height % self.network.patch_size or width % self.network.patch_size:
            raise UserError(
                f"{scene.sample.key}: {height}x{width} pixels are not divisible by the checkpoint's patch size "
                f"{self.network.patch_size}: evaluate on data of another resolution"
            )
        views = select_views(scene.sample, range(len(scene.sample.fov)), self.network.gbuffer_channels)
        rendering = self.network(RaggedBatch.pack([views]).to(self.device))
        return log_decode(rendering.log_radiance[0].float())


class RendererPredictor(Predictor):
    """A renderer on the stored triangles and cameras."""

    name = MODEL

    def __init__(self, renderer: Renderer):
        self.renderer = renderer

    def predict(self, scene: StoredScene) -> Float[Tensor, "v 3 h w"]:
        """Predict linear radiance."""
        sample, (height, width) = scene.sample, scene.reference.shape[-2:]
        packed = PackedScene(sample.key, sample.triangles, sample.c2w, sample.fov)
        images = self.renderer.render(packed, (height, width))
        return torch.from_numpy(np.ascontiguousarray(images.transpose(0, 3, 1, 2))).to(scene.reference.device)


class BaselinePredictor(Predictor):
    """A trivial baseline on the stored G-buffers."""

    def __init__(self, baseline: baselines.Baseline):
        self.baseline, self.name = baseline, baseline.name

    def predict(self, scene: StoredScene) -> Float[Tensor, "v 3 h w"]:
        """Predict linear radiance."""
        return self.baseline.predict(scene.gbuffer)


def predictor_of(renderer: Renderer) -> NetworkPredictor | RendererPredictor:
    """Choose the predictor of a renderer: a network reads the stored G-buffers, anything else renders the scene."""
    if isinstance(renderer.engine, NetworkEngine):
        return NetworkPredictor(renderer.engine.module, renderer.device)
    return RendererPredictor(renderer)


def fitted_baselines(train: ShardSplit, scenes: int) -> list[BaselinePredictor]:
    """Fit all trivial baselines on at most `scenes` evenly spaced training scenes."""
    indices = np.linspace(0, len(train) - 1, min(scenes, len(train))).round().astype(int).tolist()

    def samples() -> Iterator[tuple[dict[str, Tensor], Tensor]]:
        for index in indices:
            scene = StoredScene.of(train[index], torch.device("cpu"))
            yield scene.gbuffer, scene.reference

    kinds = (
        baselines.Black,
        baselines.MeanImage,
        baselines.AlbedoTimesConstant,
        baselines.DirectLight,
        baselines.DirectLightAndReflections,
    )
    return [BaselinePredictor(kind().fit(samples())) for kind in kinds]
