"""Hierarchical Object-Centric Tokenization (paper, Sec. 3.2): each object's triangles become n_q tokens."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.model.layers.attention import AttentionPattern
from rfpp.model.layers.block import CrossBlock, RMSNorm, SelfBlock
from rfpp.model.layers.encoding import RelativeSpatialEncoding
from rfpp.model.layers.scene_tokens import SceneTokens
from rfpp.ranges import Positive
from rfpp.segments import Segments


class ObjectTokens(nn.Module):
    """Self-attention within each object, then n_q shared queries gather its triangles.

    Args:
        width: Token width D.
        encoder_layers: Self-attention blocks over each object's triangles.
        queries: n_q, tokens per object.
        cross_layers: Cross-attention blocks from queries to triangles; a self-attention block stands between each two.
        frequencies: RSPE frequencies.
    """

    def __init__(
        self,
        width: Positive,
        heads: Positive,
        hidden: Positive,
        encoder_layers: Positive,
        queries: Positive,
        cross_layers: Positive,
        frequencies: Positive,
    ):
        super().__init__()
        self.position = RelativeSpatialEncoding(width // heads, frequencies)
        self.encoder = nn.ModuleList(SelfBlock(width, heads, hidden) for _ in range(encoder_layers))
        self.queries = nn.Parameter(torch.empty(queries, width).normal_(std=0.02))
        self.gather = nn.ModuleList(CrossBlock(width, heads, hidden) for _ in range(cross_layers))
        self.mix = nn.ModuleList(SelfBlock(width, heads, hidden) for _ in range(cross_layers - 1))
        self.norm = RMSNorm(width)

    def forward(self, triangles: Float[Tensor, "m width"], batch: RaggedBatch) -> SceneTokens:
        per_object, n_q = batch.objects, len(self.queries)
        query_segments = Segments.uniform(len(per_object), n_q, batch.positions.device)

        rotation = self.position(batch.positions.flatten(1))
        within_object = AttentionPattern(per_object)
        for block in self.encoder:
            triangles = block(triangles, within_object, rotation)

        points = object_anchors(batch).repeat_interleave(n_q, dim=0)
        anchor_rotation = self.position(points)
        to_triangles, among_queries = AttentionPattern(query_segments, per_object), AttentionPattern(query_segments)
        tokens = self.queries.repeat(len(per_object), 1)
        for i, gather in enumerate(self.gather):
            tokens = gather(tokens, triangles, to_triangles, anchor_rotation, rotation)
            if i < len(self.mix):
                tokens = self.mix[i](tokens, among_queries, anchor_rotation)

        return SceneTokens(
            features=self.norm(tokens),
            points=points,
            log_emission=mean_by_object(batch.log_emission, batch).repeat_interleave(n_q, dim=0),
            segments=batch.scenes.multiplied(n_q),
        )


def object_anchors(batch: RaggedBatch) -> Float[Tensor, "o 9"]:
    """Return each object's RSPE position: [bounding-box minimum, area-weighted centroid, bounding-box maximum]."""
    corners = batch.positions
    owner = batch.objects.index[:, None].expand(-1, 3)
    empty = corners.new_zeros(len(batch.objects), 3)
    low = empty.scatter_reduce(0, owner, corners.amin(1), "amin", include_self=False)
    high = empty.scatter_reduce(0, owner, corners.amax(1), "amax", include_self=False)
    return torch.cat([low, mean_by_object(corners.mean(1), batch), high], dim=-1)


def mean_by_object(values: Float[Tensor, "m c"], batch: RaggedBatch) -> Float[Tensor, "o c"]:
    """Return the area-weighted mean of per-triangle values over each object."""
    weighted = values * batch.areas[:, None]
    sums = weighted.new_zeros(len(batch.objects), values.shape[1]).index_add(0, batch.objects.index, weighted)
    return sums / object_areas(batch)[:, None]


def object_areas(batch: RaggedBatch) -> Float[Tensor, " o"]:
    """Return each object's surface area in square world units."""
    return batch.areas.new_zeros(len(batch.objects)).index_add(0, batch.objects.index, batch.areas)
