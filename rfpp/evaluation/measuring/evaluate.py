"""Evaluate a network and the trivial baselines on stored scenes: one record per image and predictor."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.errors import ShardError, UserError
from rfpp.evaluation.measuring.records import MODEL, ImageRecord
from rfpp.raycast.first_hit import CHANNELS as CHANNEL_SIZES
from rfpp.imaging.radiance import log_decode
from rfpp.metrics.baselines import (
    CHANNELS,
    AlbedoTimesConstant,
    Baseline,
    Black,
    DirectLightAlone,
    DirectLightReflected,
    MeanImage,
)
from rfpp.metrics.image import ImageMetrics
from rfpp.metrics.l1_parts import CHANNELS as PART_CHANNELS
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.sample import SceneSample
from rfpp.shards.views import select_views

OnScene = Callable[[], None]

#: What is known of every view beside its image, for baselines and for detailed metrics.
_KNOWN = (*CHANNELS, *PART_CHANNELS)
_SIZES = [CHANNEL_SIZES[name] for name in _KNOWN]


@dataclass(frozen=True, eq=False)
class RenderedScene:
    """All V views of one scene.

    Attributes:
        key: of the stored scene.
        triangles, objects, lights: how many it holds; every light is an object too.
        reference, prediction: [V, 3, H, W] linear radiance.
        gbuffer: the channels that baselines predict from and parts of L1 are told by, [V, 3 or 1, H, W] each.
    """

    key: str
    triangles: int
    objects: int
    lights: int
    reference: Float[Tensor, "v 3 h w"]
    prediction: Float[Tensor, "v 3 h w"]
    gbuffer: dict[str, Float[Tensor, "v _ h w"]]


@torch.no_grad()
def render_stored(network: nn.Module, split: ShardSplit, index: int, device: torch.device) -> RenderedScene:
    """Render every view of a stored scene with the network, which must be on `device`.

    Raises:
        UserError: the stored resolution is not divisible by the network's patch size.
    """
    sample = split[index]
    wanted = tuple(network.gbuffer_channels)
    views = select_views(sample, range(len(sample.fov)), (*wanted, *_KNOWN))
    batch = RaggedBatch.pack([views]).to(device)
    if any(side % network.patch_size for side in batch.resolution):
        raise UserError(
            f"{split.manifest.root}: images of {batch.resolution[0]}x{batch.resolution[1]} pixels are not divisible by "
            f"the checkpoint's patch size {network.patch_size}: evaluate on data of another resolution"
        )
    for_network, for_baselines = batch.gbuffer.tensor_split([-sum(_SIZES)], dim=2)
    rendering = network(replace(batch, gbuffer=for_network))
    return RenderedScene(
        key=sample.key,
        triangles=len(sample.triangles),
        objects=sample.triangles.num_objects,
        lights=sample.triangles.num_lights,
        reference=batch.image[0],
        prediction=log_decode(rendering.log_radiance[0].float()),
        gbuffer=_by_name(for_baselines[0]),
    )


def network_records(
    network: nn.Module,
    split: ShardSplit,
    metrics: ImageMetrics,
    device: torch.device,
    on_scene: OnScene,
    predictor: str = MODEL,
) -> list[ImageRecord]:
    """The network's scores on every image of the split.

    Args:
        on_scene: called after each scene, for a progress bar.
        predictor: its name in the records.

    Raises:
        ShardError: the split is empty, or a sample is damaged.
        UserError: see `render_stored`.
    """
    records = []
    for index in _scenes(split):
        scene = render_stored(network, split, index, device)
        at = (split.split, scene.key, scene.triangles, scene.objects, scene.lights)
        records += _image_records(at, predictor, metrics(scene.prediction, scene.reference, scene.gbuffer))
        on_scene()
    return records


def baseline_records(
    baselines: Sequence[Baseline], split: ShardSplit, metrics: ImageMetrics, device: torch.device, on_scene: OnScene
) -> list[ImageRecord]:
    """The baselines' scores on every image of the split, independent of the network.

    Arguments and errors are those of `network_records`.
    """
    records = []
    for index in _scenes(split):
        sample = split[index]
        gbuffer, reference = known_views(sample, device)
        counts = (len(sample.triangles), sample.triangles.num_objects, sample.triangles.num_lights)
        for baseline in baselines:
            values = metrics(baseline.predict(gbuffer), reference, gbuffer)
            records += _image_records((split.split, sample.key, *counts), baseline.name, values)
        on_scene()
    return records


def fitted_baselines(train: ShardSplit, scenes: int) -> list[Baseline]:
    """All trivial baselines, fitted on at most `scenes` evenly spaced training scenes."""
    baselines = (Black(), MeanImage(), AlbedoTimesConstant(), DirectLightAlone(), DirectLightReflected())
    return [baseline.fit(_training_views(train, scenes)) for baseline in baselines]


def _scenes(split: ShardSplit) -> range:
    if len(split) == 0:
        raise ShardError(f"{split.manifest.root}: split '{split.split}' is empty: choose another in evaluation.splits")
    return range(len(split))


def _image_records(
    at: tuple[str, str, int, int, int], predictor: str, values: Mapping[str, Float[Tensor, " v"]]
) -> list[ImageRecord]:
    """Records of all views of one scene. Args: at: split, scene, triangles, objects, lights."""
    split, scene, *counts = at
    by_view = zip(*(column.tolist() for column in values.values()), strict=True)
    return [
        ImageRecord(split, scene, view, *counts, predictor, dict(zip(values, numbers, strict=True)))
        for view, numbers in enumerate(by_view)
    ]


def _training_views(split: ShardSplit, scenes: int) -> Iterator[tuple[dict[str, Tensor], Tensor]]:
    """(channels, radiance), all [V, 3, H, W], scene by scene."""
    count = min(scenes, len(split))
    for index in np.linspace(0, len(split) - 1, count).round().astype(int):
        yield known_views(split[int(index)], torch.device("cpu"))


def known_views(sample: SceneSample, device: torch.device) -> tuple[dict[str, Float[Tensor, "v _ h w"]], Tensor]:
    """What baselines predict a stored scene's views from, by channel, and the views' [V, 3, H, W] linear radiance."""
    views = select_views(sample, range(len(sample.fov)), _KNOWN)
    return _by_name(torch.from_numpy(views.gbuffer).to(device)), torch.from_numpy(views.image).to(device)


def _by_name(gbuffer: Float[Tensor, "v c h w"]) -> dict[str, Float[Tensor, "v _ h w"]]:
    return dict(zip(_KNOWN, gbuffer.split(_SIZES, dim=1), strict=True))
