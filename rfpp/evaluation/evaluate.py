"""A network and the trivial baselines on every view of stored scenes: one record per image and predictor."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.errors import ShardError, UserError
from rfpp.evaluation.tables import ImageRecord, scene_means
from rfpp.metrics.baselines import CHANNELS, AlbedoTimesConstant, Baseline, Black, DirectLightAlone, MeanImage
from rfpp.metrics.image import METRICS, ImageMetrics
from rfpp.radiance import log_decode
from rfpp.shards.stream import ShardSplit
from rfpp.training.views import select_views

#: The name of the network in records.
MODEL = "model"


@dataclass(frozen=True, eq=False)
class RenderedScene:
    """All V views of one scene.

    Attributes:
        key: of the stored scene.
        reference, prediction: [V, 3, H, W] linear radiance.
        gbuffer: what baselines predict from, [V, 3, H, W] each.
    """

    key: str
    reference: Float[Tensor, "v 3 h w"]
    prediction: Float[Tensor, "v 3 h w"]
    gbuffer: dict[str, Float[Tensor, "v 3 h w"]]


@torch.no_grad()
def render_stored(network: nn.Module, split: ShardSplit, index: int, device: torch.device) -> RenderedScene:
    """Render every view of a stored scene with the network, which must be on `device`.

    Raises:
        UserError: the stored resolution is not divisible by the network's patch size.
    """
    sample = split[index]
    wanted = tuple(network.gbuffer_channels)
    views = select_views(sample, range(len(sample.fov)), (*wanted, *CHANNELS))
    batch = RaggedBatch.pack([views]).to(device)
    if any(side % network.patch_size for side in batch.resolution):
        raise UserError(
            f"{split.manifest.root}: images of {batch.resolution[0]}x{batch.resolution[1]} pixels are not divisible by "
            f"the checkpoint's patch size {network.patch_size}: evaluate on data of another resolution"
        )
    for_network, for_baselines = batch.gbuffer.tensor_split([-3 * len(CHANNELS)], dim=2)
    rendering = network(replace(batch, gbuffer=for_network))
    return RenderedScene(
        key=sample.key,
        reference=batch.image[0],
        prediction=log_decode(rendering.log_radiance[0].float()),
        gbuffer=_by_name(for_baselines[0]),
    )


def evaluate_split(
    network: nn.Module,
    split: ShardSplit,
    baselines: Sequence[Baseline],
    metrics: ImageMetrics,
    device: torch.device,
    on_scene: Callable[[], None] = lambda: None,
) -> list[ImageRecord]:
    """Records of every image of the split, for the network and for each baseline.

    Args:
        on_scene: called after each scene, for a progress bar.

    Raises:
        ShardError: the split is empty, or a sample is damaged.
        UserError: see `render_stored`.
    """
    if len(split) == 0:
        raise ShardError(f"{split.manifest.root}: split '{split.split}' is empty: choose another in evaluation.splits")
    records = []
    for index in range(len(split)):
        scene = render_stored(network, split, index, device)
        predictions = {MODEL: scene.prediction} | {b.name: b.predict(scene.gbuffer) for b in baselines}
        for predictor, prediction in predictions.items():
            values = {name: column.tolist() for name, column in metrics(prediction, scene.reference).items()}
            for view in range(len(prediction)):
                at_view = {name: column[view] for name, column in values.items()}
                records.append(ImageRecord(split.split, scene.key, view, predictor, at_view))
        on_scene()
    return records


def fitted_baselines(train: ShardSplit, scenes: int) -> list[Baseline]:
    """Every trivial baseline, fitted on evenly spaced training scenes, at most `scenes` of them."""
    baselines = (Black(), MeanImage(), AlbedoTimesConstant(), DirectLightAlone())
    return [baseline.fit(_training_views(train, scenes)) for baseline in baselines]


def ranked_scenes(records: Sequence[ImageRecord], metric: str = "log_l1") -> dict[str, int]:
    """The model's best, median and worst scene of one split: caption, with its mean error → index in the split.

    Args:
        records: of one whole split, in its order.
        metric: one where lower is better.
    """
    means = scene_means(record for record in records if record.predictor == MODEL)
    errors = [(values[metric], index, key) for index, ((_, _, key), values) in enumerate(means.items())]
    ranked = sorted(errors)
    chosen = {"best": ranked[0], "median": ranked[len(ranked) // 2], "worst": ranked[-1]}
    label = METRICS[metric].label
    return {f"{place}: {key}, {label} {error:.4f}": index for place, (error, index, key) in chosen.items()}


def _training_views(split: ShardSplit, scenes: int) -> Iterator[tuple[dict[str, Tensor], Tensor]]:
    """(channels, radiance), all [V, 3, H, W], scene by scene."""
    count = min(scenes, len(split))
    for index in np.linspace(0, len(split) - 1, count).round().astype(int):
        sample = split[int(index)]
        views = select_views(sample, range(len(sample.fov)), CHANNELS)
        yield _by_name(torch.from_numpy(views.gbuffer)), torch.from_numpy(views.image)


def _by_name(gbuffer: Float[Tensor, "v c h w"]) -> dict[str, Float[Tensor, "v 3 h w"]]:
    return dict(zip(CHANNELS, gbuffer.split(3, dim=1), strict=True))
