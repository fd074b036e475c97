"""From triangle tokens to the scene's tokens: one per triangle, or n_q per object (HOCT)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.model.attention import AttentionPattern
from rfpp.model.block import CrossBlock, RMSNorm, SelfBlock
from rfpp.model.encoding import RelativeSpatialEncoding
from rfpp.model.lit_cells import LitCells
from rfpp.packed_cells import PackedCells
from rfpp.segments import Segments


@dataclass(frozen=True)
class SceneTokens:
    """The tokens of B scenes, packed.

    Attributes:
        features: [N, D].
        points: [N, 9] three world-space points that place each token.
        log_light: [N, 3] what the transport starts from: log10(1 + emitted radiance), area-weighted over what the token
            stands for, or what another `source` says.
        segments: B segments of the N tokens.
        cells: of the scenes, for networks that move light between them; lit once it has.
        bounces: of the light of each scene's images, see `rfpp.batch.SceneViews`; empty where nobody asks.
    """

    features: Float[Tensor, "n width"]
    points: Float[Tensor, "n 9"]
    log_light: Float[Tensor, "n 3"]
    segments: Segments
    cells: PackedCells | LitCells | None = None
    bounces: tuple[int | None, ...] = ()

    @property
    def unlit_cells(self) -> PackedCells:
        """`cells` before light has moved. Raises ValueError if there are none."""
        if not isinstance(self.cells, PackedCells):
            raise ValueError("light is to move between cells, but these tokens have none: see `CellLight`")
        return self.cells

    @property
    def lit_cells(self) -> LitCells:
        """`cells` after light has moved. Raises ValueError if there are none."""
        if not isinstance(self.cells, LitCells):
            raise ValueError("light is to be gathered from cells, but none are lit: see `LinearTransport`")
        return self.cells

    @classmethod
    def joined(cls, parts: Sequence[SceneTokens], objects: Sequence[int]) -> SceneTokens:
        """Tokens of objects, one after another, as those of scenes of so many `objects`."""
        names = ("features", "points", "log_light")
        features, points, log_light = (torch.cat([getattr(part, name) for part in parts]) for name in names)
        per_object = len(features) // sum(objects)
        segments = Segments.from_lengths([per_object * count for count in objects], features.device)
        return cls(features, points, log_light, segments)

    def split(self, objects: int) -> list[SceneTokens]:
        """The tokens of each of so many objects, in memory of their own."""
        parts = zip(*(x.chunk(objects) for x in (self.features, self.points, self.log_light)), strict=True)
        segments = Segments.from_lengths([len(self.features) // objects], self.features.device)
        return [SceneTokens(f.clone(), p.clone(), light.clone(), segments) for f, p, light in parts]


class TriangleTokens(nn.Module):
    """One token per triangle, after each scene's registers: learned tokens that stand for nothing (RenderFormer).

    Args:
        width: token width.
        registers: per scene, placed at the mean of its vertices (RenderFormer has 16).
    """

    #: What batches must carry besides triangles.
    reads: tuple[str, ...] = ()

    def __init__(self, width: int, registers: int):
        super().__init__()
        self.registers = nn.Parameter(torch.empty(registers, width).normal_(std=0.02))

    def forward(self, triangles: Float[Tensor, "m width"], batch: RaggedBatch) -> SceneTokens:
        device, scenes, registers = triangles.device, len(batch.scenes), len(self.registers)
        per_scene = batch.objects.grouped(batch.scenes)
        centre = batch.positions.new_zeros(scenes, 3).index_add(0, per_scene.index, batch.positions.mean(1))
        centre = centre / per_scene.sizes[:, None]

        # all registers, then all triangles, are sorted into registers and triangles of the first scene, of the second …
        owner = torch.cat([torch.arange(scenes, device=device).repeat_interleave(registers), per_scene.index])
        order = owner.argsort(stable=True)
        points = torch.cat([centre.repeat(1, 3).repeat_interleave(registers, 0), batch.positions.flatten(1)])
        nothing = batch.log_emission.new_zeros(scenes * registers, 3)
        return SceneTokens(
            features=torch.cat([self.registers.to(triangles.dtype).repeat(scenes, 1), triangles])[order],
            points=points[order],
            log_light=torch.cat([nothing, batch.log_emission])[order],
            segments=per_scene.lengthened(registers),
        )


class ObjectTokens(nn.Module):
    """HOCT (paper, Sec. 3.2): self-attention within each object, then n_q shared queries summarise it.

    Args:
        width, heads, hidden: token width, attention heads, SwiGLU width.
        encoder_layers: self-attention blocks over each object's triangles.
        queries: n_q, tokens per object.
        cross_layers: cross-attention blocks from queries to triangles, with a self-attention block between
            each two of them.
        frequencies: RSPE frequencies.
    """

    def __init__(
        self,
        width: int,
        heads: int,
        hidden: int,
        encoder_layers: int,
        queries: int,
        cross_layers: int,
        frequencies: int,
    ):
        super().__init__()
        self.position = RelativeSpatialEncoding(width // heads, frequencies)
        self.encoder = nn.ModuleList(SelfBlock(width, heads, hidden) for _ in range(encoder_layers))
        self.queries = nn.Parameter(torch.empty(queries, width).normal_(std=0.02))
        self.gather = nn.ModuleList(CrossBlock(width, heads, hidden) for _ in range(cross_layers))
        self.mix = nn.ModuleList(SelfBlock(width, heads, hidden) for _ in range(cross_layers - 1))
        self.norm = RMSNorm(width)

    #: What batches must carry besides triangles.
    reads: tuple[str, ...] = ()

    def anchors(self, batch: RaggedBatch) -> Float[Tensor, "n 9"]:
        """Where tokens stand: all of an object's at one place."""
        return object_anchors(batch).repeat_interleave(len(self.queries), dim=0)

    def forward(self, triangles: Float[Tensor, "m width"], batch: RaggedBatch) -> SceneTokens:
        per_object, n_q = batch.objects, len(self.queries)
        query_segments = Segments.from_lengths([n_q] * len(per_object), batch.positions.device)

        rotation = self.position(batch.positions.flatten(1))
        within_object = AttentionPattern(per_object)
        for block in self.encoder:
            triangles = block(triangles, within_object, rotation)

        points = self.anchors(batch)
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
            log_light=mean_by_object(batch.log_emission, batch).repeat_interleave(n_q, dim=0),
            segments=Segments.from_lengths([n_q * n for n in batch.scenes.lengths], batch.positions.device),
        )


class OctantTokens(ObjectTokens):
    """HOCT whose eight tokens stand at the eight octants of their object, those that the cells of a scene belong to.

    Not in the paper, where all tokens of an object stand at its bounding box. An octant's place moves with its object.
    """

    reads = ("cells",)

    def anchors(self, batch: RaggedBatch) -> Float[Tensor, "n 9"]:
        """From the object's centroid through the octant's, and as far again beyond.

        Raises ValueError where the batch does not carry octants, UserError where there are not eight tokens an object.
        """
        if batch.octants is None:
            raise ValueError("tokens stand at octants of objects, but the batch carries no cells to tell them by")
        if len(self.queries) != 8:
            raise UserError(f"queries={len(self.queries)}: an object has eight octants: give the network 8")
        octant = batch.octants.to(batch.positions)
        centre = mean_by_object(batch.positions.mean(1), batch).repeat_interleave(8, dim=0)
        return torch.cat([centre, octant, 2 * octant - centre], dim=-1)


def object_anchors(batch: RaggedBatch) -> Float[Tensor, "o 9"]:
    """Where an object stands: [bounding-box minimum, area-weighted centroid, bounding-box maximum]."""
    corners = batch.positions
    owner = batch.objects.index[:, None].expand(-1, 3)
    empty = corners.new_zeros(len(batch.objects), 3)
    low = empty.scatter_reduce(0, owner, corners.amin(1), "amin", include_self=False)
    high = empty.scatter_reduce(0, owner, corners.amax(1), "amax", include_self=False)
    return torch.cat([low, mean_by_object(corners.mean(1), batch), high], dim=-1)


def mean_by_object(values: Float[Tensor, "m c"], batch: RaggedBatch) -> Float[Tensor, "o c"]:
    """Area-weighted mean of per-triangle values over each object."""
    weighted = values * batch.areas[:, None]
    sums = weighted.new_zeros(len(batch.objects), values.shape[1]).index_add(0, batch.objects.index, weighted)
    return sums / object_areas(batch)[:, None]


def object_areas(batch: RaggedBatch) -> Float[Tensor, " o"]:
    """Surface of each object in square world units."""
    return batch.areas.new_zeros(len(batch.objects)).index_add(0, batch.objects.index, batch.areas)
