"""Geometry-guided decoder (paper, Sec. 3.3): ray-bundle tokens of each view read the scene tokens in camera space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Annotated

import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn

from rfpp.model.dpt import LEVELS, DPTHead
from rfpp.model.layers.attention import AttentionPattern
from rfpp.model.layers.block import CrossAttention, RMSNorm, SelfAttention, SwiGLU
from rfpp.model.layers.camera_space import to_camera
from rfpp.model.layers.encoding import RelativeSpatialEncoding, Rotation, rotate
from rfpp.model.layers.ray_windows import ShiftedWindows, WholeView
from rfpp.model.layers.scene_tokens import SceneTokens
from rfpp.model.ray_bundle import RayBundleEmbedding
from rfpp.ranges import Positive
from rfpp.segments import Segments


class ViewDecoder(nn.Module):
    """VDecoder: cross-attention to the scene, self-attention in the view, SwiGLU; then a DPT head.

    Ray tokens stand at the camera, the origin of camera space, so their positions rotate nothing.

    Args:
        width: Token width D.
        layers: Decoder blocks, at least 4: the last four feed the head.
        frequencies: RSPE frequencies.
        patch_size: Pixels along a patch's side.
        gbuffer_channels: See `RayBundleEmbedding`; empty for the decoder without geometry guidance.
        head_level_channels: See `DPTHead`.
        head_channels: See `DPTHead`.
        windows: Rays of a view that attend to each other: `WholeView` (the paper's) or `ShiftedWindows`.
    """

    def __init__(
        self,
        width: Positive,
        heads: Positive,
        hidden: Positive,
        layers: Positive,
        frequencies: Positive,
        patch_size: Positive,
        gbuffer_channels: Sequence[str],
        head_level_channels: Annotated[Sequence[Positive], Field(min_length=LEVELS, max_length=LEVELS)],
        head_channels: Positive,
        windows: WholeView | ShiftedWindows,
    ):
        super().__init__()
        if layers < LEVELS:
            raise ValueError(f"the image head reads the last {LEVELS} decoder layers, but there are {layers}")
        self.rays = RayBundleEmbedding(width, patch_size, gbuffer_channels)
        self.windows = windows
        self.position = RelativeSpatialEncoding(width // heads, frequencies)
        self.blocks = nn.ModuleList(DecoderBlock(width, heads, hidden) for _ in range(layers))
        self.head = DPTHead(width, head_level_channels, head_channels, patch_size)

    def forward(
        self,
        scene: SceneTokens,
        c2w: Float[Tensor, "b v 4 4"],
        fov: Float[Tensor, "b v"],
        gbuffer: Float[Tensor, "b v c h w"],
        exposure: Float[Tensor, " b"],
    ) -> Float[Tensor, "b v 3 h w"]:
        """Return log10(1 + radiance / exposure) of every view of every scene, float32.

        Args:
            fov: Full angle in degrees along the longer image side.
            gbuffer: `gbuffer_channels`, light in linear units.
            exposure: Radiance that the scene tokens call 1.
        """
        batch, views, _, height, width = gbuffer.shape
        grid = (height // self.rays.patch_size, width // self.rays.patch_size)
        rays = self.rays(fov.flatten(), gbuffer.flatten(0, 1), exposure.repeat_interleave(views))  # [B V, patches, D]

        seen = CameraTokens.by(scene, c2w)
        token_rotation = self.position(seen.points)
        in_view = Segments.uniform(batch * views, rays.shape[1], rays.device)
        to_scene = AttentionPattern(in_view, seen.segments)
        among_rays = cycle(self.windows(batch * views, *grid, rays.device))

        x, features = rays.flatten(0, 1), []
        for block in self.blocks:
            x = block(x, scene.features, seen.rows, to_scene, next(among_rays), token_rotation)
            features.append(x)

        levels = [f.view(batch * views, *grid, -1).permute(0, 3, 1, 2) for f in features[-LEVELS:]]
        log_radiance: Tensor = self.head(levels, height, width)
        return log_radiance.view(batch, views, 3, height, width)

    @property
    def gbuffer_channels(self) -> tuple[str, ...]:
        """G-buffer channels that a batch must carry, in order."""
        return self.rays.gbuffer_channels


class DecoderBlock(nn.Module):
    """Cross-attention from rays to the scene, self-attention between rays, SwiGLU."""

    def __init__(self, width: int, heads: int, hidden: int):
        super().__init__()
        self.query_norm, self.context_norm = RMSNorm(width), RMSNorm(width)
        self.cross_attention = CrossAttention(width, heads)
        self.self_attention_norm, self.self_attention = RMSNorm(width), SelfAttention(width, heads)
        self.feed_forward_norm, self.feed_forward = RMSNorm(width), SwiGLU(width, hidden)

    def forward(
        self,
        x: Float[Tensor, "n width"],
        scene: Float[Tensor, "m width"],
        rows: Int[Tensor, " seen"],
        to_scene: AttentionPattern,
        among_rays: AttentionPattern,
        token_rotation: Rotation,
    ) -> Float[Tensor, "n width"]:
        # keys and values are projected once per scene; a view selects its scene's rows and rotates them into its camera
        keys, values = self.cross_attention.project(self.context_norm(scene))
        keys, values = rotate(keys.index_select(0, rows), token_rotation), values.index_select(0, rows)
        x = x + self.cross_attention(self.query_norm(x), keys, values, to_scene, None)
        x = x + self.self_attention(self.self_attention_norm(x), among_rays, None)
        out: Tensor = x + self.feed_forward(self.feed_forward_norm(x))
        return out


@dataclass(frozen=True)
class CameraTokens:
    """Scene tokens as B·V cameras see them.

    Attributes:
        rows: Token of the batch that each row is, scene by scene, view by view.
        points: [rows, 9] the tokens' points in camera space.
        segments: B·V segments of the rows.
    """

    rows: Int[Tensor, " rows"]
    points: Float[Tensor, "rows 9"]
    segments: Segments

    @classmethod
    def by(cls, scene: SceneTokens, c2w: Float[Tensor, "b v 4 4"]) -> CameraTokens:
        """Transform each scene's tokens into the cameras of its views."""
        scenes, views = c2w.shape[:2]
        segments = scene.segments.repeated(views, scenes)
        first = scene.segments.offsets[:scenes].repeat_interleave(views) - segments.offsets[:-1]  # of each view's rows
        rows = torch.arange(segments.total, device=c2w.device) + first[segments.index]
        if segments.unowned:
            rows = rows.clamp(max=len(scene.points) - 1)
        camera = c2w.flatten(0, 1)[segments.index]
        points = to_camera(scene.points[rows].unflatten(-1, (3, 3)), camera)
        return cls(rows, points.flatten(1), segments)
