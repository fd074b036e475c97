"""Every network of the project at a small size, with a batch and a loss for it."""

import numpy as np
from random_scenes import random_views

from rfpp.batch import RaggedBatch
from rfpp.losses.rendering import RenderingLoss
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.raycast.first_hit import CHANNELS

#: FlashAttention wants heads of a multiple of eight.
HEADS = ("size.width=64", "size.heads=1")
PAPER = ("experiment=large_scale", "size=tiny", *HEADS)
VARIANTS = {
    "paper": PAPER,
    "known_light": ("experiment=[quickstart,known_light]", *HEADS),
    "windows": (*PAPER, "+model.decoder.windows={_target_: rfpp.model.layers.ray_windows.ShiftedWindows, size: 2}"),
    **{
        name: (f"experiment=[large_scale,paper/{name}]", "size=tiny", *HEADS)
        # without_tcl and other iterations are the paper's network, renderformer_finetuned RenderFormer's
        for name in ("without_pitg", "without_ggd", "renderformer", "renderformer_pitg", "renderformer_hoct")
    },
}  # fmt: skip


def batch_for(
    net: RenderFormerPP, resolution: int = 16, sizes: tuple[tuple[int, ...], ...] = ((14, 6, 1), (3, 9, 2, 1))
) -> RaggedBatch:
    """Scenes of objects of so many triangles, with the channels that a network reads."""
    rng, channels = np.random.default_rng(0), sum(CHANNELS[name] for name in net.gbuffer_channels)
    return RaggedBatch.pack([random_views(rng, each, resolution=resolution, channels=channels) for each in sizes])


def loss() -> RenderingLoss:
    return RenderingLoss(
        l1_weight=1.0, lpips_weight=0.0, consistency_weight=0.1, lpips_images_per_step=None,
        consistency_stop_gradient=False,
    )  # fmt: skip
