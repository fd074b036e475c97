"""Error of bfloat16 rendering against float32 and against the reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.checkpoint.loading import load_network
from rfpp.imaging.radiance import log_decode
from rfpp.metrics.image import log_l1
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.views import AllViews

Row = dict[str, str | int | float]


@torch.inference_mode()
def measure(
    checkpoint: str, root: str, split: str, scenes: int, device: str, progress: Callable[[int, int], None]
) -> list[Row]:
    """A row per precision: mean error of the images, and how far they are from those in float32.

    `log_l1` is of images against their references; `difference` and `largest_difference` are of log10(1 + radiance)
    against float32, mean and largest of all pixels.

    Args:
        checkpoint: of a trained network.
        root, split: of stored scenes; the first `scenes` are taken.
        device: where to render.
        progress: called with (scenes rendered, scenes in all).
    """
    network, info = load_network(Path(checkpoint))
    network = network.to(device).eval()
    stored = AllViews(ShardSplit(root, split), network.gbuffer_channels)
    count = min(scenes, len(stored))
    sums: dict[str, list[float]] = {name: [0.0, 0.0, 0.0] for name in PRECISIONS}
    for index in range(count):
        batch = RaggedBatch.pack([stored[index]]).to(device)
        expected = float32(network, batch)
        for name, render in PRECISIONS.items():
            image = render(network, batch).float()
            error = log_l1(log_decode(image[0]).clamp_min(0), batch.image[0]).mean()
            difference = (image - expected).abs()
            total = sums[name]
            sums[name] = [
                total[0] + float(error) / count,
                total[1] + float(difference.mean()) / count,
                max(total[2], float(difference.max())),
            ]
        progress(index + 1, count)
    trained = {"network": info.method, "dataset": info.dataset, "steps": info.steps}
    names = ("log_l1", "difference", "largest_difference")
    return [
        {"precision": precision, **dict(zip(names, values, strict=True)), "images": count * batch.num_views, **trained}
        for precision, values in sums.items()
    ]


def float32(network: RenderFormerPP, batch: RaggedBatch) -> Float[Tensor, "1 v 3 h w"]:
    """Every operation."""
    return network(batch).log_radiance


def autocast(network: RenderFormerPP, batch: RaggedBatch) -> Float[Tensor, "1 v 3 h w"]:
    """Matrix products and what follows on them in bfloat16; positions, rotary angles, mean squares in float32."""
    with _bfloat16(batch):
        return network(batch).log_radiance


def autocast_scene(network: RenderFormerPP, batch: RaggedBatch) -> Float[Tensor, "1 v 3 h w"]:
    """The view-independent stage alone."""
    with _bfloat16(batch):
        scenes = network.encode(batch)
    return network.view(scenes, batch.c2w, batch.fov, batch.gbuffer)


def autocast_views(network: RenderFormerPP, batch: RaggedBatch) -> Float[Tensor, "1 v 3 h w"]:
    """The view-dependent stage alone."""
    scenes = network.encode(batch)
    with _bfloat16(batch):
        return network.view(scenes, batch.c2w, batch.fov, batch.gbuffer)


def rounded_positions(network: RenderFormerPP, batch: RaggedBatch) -> Float[Tensor, "1 v 3 h w"]:
    """As `autocast`, after positions and cameras have been rounded to bfloat16: why they are not."""
    rounded = {name: getattr(batch, name).bfloat16().float() for name in ("positions", "c2w")}
    return autocast(network, replace(batch, **rounded))


PRECISIONS: dict[str, Callable[[RenderFormerPP, RaggedBatch], Tensor]] = {
    "float32": float32,
    "bfloat16": autocast,
    "bfloat16, scene alone": autocast_scene,
    "bfloat16, views alone": autocast_views,
    "bfloat16, positions too": rounded_positions,
}


def _bfloat16(batch: RaggedBatch) -> torch.autocast:
    return torch.autocast(batch.positions.device.type, torch.bfloat16)
