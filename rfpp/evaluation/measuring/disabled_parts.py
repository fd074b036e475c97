"""Which parts of a network are used: error growth when each is disabled."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from rfpp.batch import RaggedBatch
from rfpp.losses.error_growth import EXCHANGED_SCENE, EXCHANGED_TOKENS, NO_TRANSPORT, PERMUTED_LIGHT, ErrorGrowth
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.views import AllViews

#: What was made useless, as tables call it.
HEADINGS = {
    EXCHANGED_TOKENS: "with other scenes' tokens",
    EXCHANGED_SCENE: "with other scenes' tokens and light",
    PERMUTED_LIGHT: "with the cells' light dealt anew",
    NO_TRANSPORT: "without transport",
}


@torch.no_grad()
def growth_by_part(network: RenderFormerPP, split: ShardSplit, device: torch.device, scenes: int) -> dict[str, float]:
    """Relative growth of log-L1 with each part disabled; empty for a single scene.

    Args:
        network: in evaluation mode, on `device`.
        scenes: of the split, at most, its first ones.
    """
    views, growth = AllViews(split, network.gbuffer_channels), ErrorGrowth()
    for index in range(min(scenes, len(views))):
        batch = RaggedBatch.pack([views[index]]).to(device)
        growth.add(network, batch, network(batch).log_radiance)
    return growth.shares()


def growth_text(shares: Mapping[str, float]) -> str:
    """E.g. "log-L1 with other scenes' tokens +2%, without transport +108%"."""
    return "log-L1 " + ", ".join(f"{HEADINGS[what]} {share:+.0%}" for what, share in shares.items())
