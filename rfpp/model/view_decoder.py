"""The view-dependent stage: ray-bundle tokens of each view read the scene's tokens, in camera space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np
from jaxtyping import Float, Int
from torch import Tensor, nn

from rfpp.model.attention import AttentionPattern
from rfpp.model.block import CrossAttention, RMSNorm, SelfAttention, SwiGLU
from rfpp.model.camera_space import to_camera
from rfpp.model.dpt import LEVELS, DPTHead
from rfpp.model.encoding import RelativeSpatialEncoding, Rotation, rotate
from rfpp.model.guided_upsampling import GuidedUpsampling
from rfpp.model.pixel_filter import CentreSample, PixelFilter
from rfpp.model.points import means, repeated
from rfpp.model.ray_bundle import CameraOrigin, FirstHitPosition, RayBundleEmbedding
from rfpp.model.ray_windows import ShiftedWindows, WholeView
from rfpp.model.shading import Shading
from rfpp.model.tokenizer import SceneTokens
from rfpp.model.view_channels import ViewChannels
from rfpp.segments import Segments, on_device


class ViewDecoder(nn.Module):
    """VDecoder (paper, Sec. 3.3): cross-attention to the scene, self-attention in the view, SwiGLU; DPT head.

    Args:
        width, heads, hidden: token width, attention heads, SwiGLU width.
        layers: decoder blocks, at least 4: the last four feed the head.
        frequencies: RSPE frequencies.
        patch_size: pixels along a patch's side.
        gbuffer_channels: see RayBundleEmbedding; empty for the decoder without geometry guidance.
        head_level_channels, head_channels: see DPTHead.
        ray_position: where ray tokens stand: CameraOrigin (the paper's) or FirstHitPosition.
        shading: what the head predicts: LogRadiance (the paper's) or another of `rfpp.model.shading`.
        film: what a pixel is made of: CentreSample (the paper's) or PixelFilter.
        windows: which rays of a view see each other: WholeView (the paper's) or ShiftedWindows.
    """

    #: Whether the image of several lights is the sum of theirs.
    linear_in_lights = False

    def __init__(
        self,
        width: int,
        heads: int,
        hidden: int,
        layers: int,
        frequencies: int,
        patch_size: int,
        gbuffer_channels: Sequence[str],
        head_level_channels: Sequence[int],
        head_channels: int,
        ray_position: CameraOrigin | FirstHitPosition,
        shading: Shading,
        film: CentreSample | PixelFilter,
        windows: WholeView | ShiftedWindows,
    ):
        super().__init__()
        if layers < LEVELS:
            raise ValueError(f"the image head reads the last {LEVELS} decoder layers, but there are {layers}")
        self.rays = RayBundleEmbedding(width, patch_size, gbuffer_channels)
        self.ray_position, self.shading, self.film, self.windows = ray_position, shading, film, windows
        self.upsampling = GuidedUpsampling()
        self.position = RelativeSpatialEncoding(width // heads, frequencies)
        self.blocks = nn.ModuleList(DecoderBlock(width, heads, hidden) for _ in range(layers))
        self.head = DPTHead(width, head_level_channels, head_channels, patch_size, shading.maps)

    def forward(
        self,
        scene: SceneTokens,
        c2w: Float[Tensor, "b v 4 4"],
        fov: Float[Tensor, "b v"],
        gbuffer: Float[Tensor, "b v c h w"],
        exposure: Float[Tensor, " b"],
        supersampling: int = 1,
        stride: int = 1,
    ) -> Float[Tensor, "b v 3 height width"]:
        """Linear radiance of every view of every scene, in units of its exposure.

        Args:
            gbuffer: `gbuffer_channels`; light as it is.
            exposure: radiance that the scene tokens call 1; what the decoder reads of light is divided by it.
            supersampling: points of the G-buffer along each side of a pixel. Tokens read their means, radiance is
                shaded point by point: smooth outlines for the price of a finer G-buffer.
            stride: pixels along each side of what is one pixel to tokens and head. What the head says is carried to
                pixels by a guided filter, and light is gathered and shaded there.
        """
        batch, views, _, *size = gbuffer.shape
        height, width = (points // supersampling for points in size)
        coarse = (height // stride, width // stride)
        unit = exposure.repeat_interleave(views)
        of_points = ViewChannels(gbuffer.flatten(0, 1), self.gbuffer_channels, unit)
        of_pixels = self._completed(of_points.pooled(supersampling), scene)
        of_rays = of_pixels.pooled(stride)
        rays = self.rays(fov.flatten(), of_rays(self.rays.gbuffer_channels))  # [B V, patches, D]
        patches = rays.shape[1]
        grid = (coarse[0] // self.rays.patch_size, coarse[1] // self.rays.patch_size)
        in_view = Segments.from_lengths([patches] * (batch * views), rays.device)
        seen = SeenTokens.by(scene, c2w)

        side = self.rays.patch_size * stride * supersampling
        ray_points = self.ray_position(of_points(self.ray_position.channels), side)
        ray_rotation = None if ray_points is None else self.position(ray_points)
        seen_rotation = self.position(seen.points)
        to_scene = AttentionPattern(in_view, seen.segments)
        among_rays = cycle(self.windows(batch * views, *grid, rays.device))

        x, features = rays.flatten(0, 1), []
        for block in self.blocks:
            x = block(x, scene.features, seen.rows, to_scene, next(among_rays), ray_rotation, seen_rotation)
            features.append(x)

        levels = [f.view(batch * views, *grid, -1).permute(0, 3, 1, 2) for f in features[-LEVELS:]]
        maps = self.head(levels, *coarse)
        if stride > 1:
            guides = (of.linear(self.upsampling.channels) for of in (of_rays, of_pixels))
            maps = self.upsampling(maps.float(), *guides)
        radiance = self._shaded(maps, scene, of_pixels, of_points, supersampling)
        return self.film(radiance, supersampling).view(batch, views, 3, height, width)

    def _completed(self, of_pixels: ViewChannels, scene: SceneTokens) -> ViewChannels:
        """With what rays are given besides the G-buffer: nothing."""
        return of_pixels

    def _shaded(
        self,
        maps: Float[Tensor, "n maps h w"],
        scene: SceneTokens,
        of_pixels: ViewChannels,
        of_points: ViewChannels,
        supersampling: int,
    ) -> Float[Tensor, "n 3 h w"]:
        """From the head's maps to linear radiance."""
        predicted = repeated(maps, supersampling)
        return means(self.shading(predicted, of_points(self.shading.channels)), supersampling)

    @property
    def gbuffer_channels(self) -> tuple[str, ...]:
        """The channels a batch must carry, in order: what any of the parts reads."""
        parts = (self.ray_position, self.shading)
        return tuple(dict.fromkeys([*self.rays.gbuffer_channels, *(name for part in parts for name in part.channels)]))


class DecoderBlock(nn.Module):
    """Rays read the scene, then each other, then think."""

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
        ray_rotation: Rotation | None,
        seen_rotation: Rotation,
    ) -> Float[Tensor, "n width"]:
        # projected once per scene; a view only picks its scene's rows and rotates them into its camera
        keys, values = self.cross_attention.project(self.context_norm(scene))
        keys, values = rotate(keys.index_select(0, rows), seen_rotation), values.index_select(0, rows)
        x = x + self.cross_attention(self.query_norm(x), keys, values, to_scene, ray_rotation)
        x = x + self.self_attention(self.self_attention_norm(x), among_rays, ray_rotation)
        out: Tensor = x + self.feed_forward(self.feed_forward_norm(x))
        return out


@dataclass(frozen=True)
class SeenTokens:
    """The scene tokens as B·V cameras see them.

    Attributes:
        rows: which token of the batch each row is, scene by scene, view by view.
        points: [rows, 9] their points in camera space.
        segments: B·V segments of the rows.
    """

    rows: Int[Tensor, " rows"]
    points: Float[Tensor, "rows 9"]
    segments: Segments

    @classmethod
    def by(cls, scene: SceneTokens, c2w: Float[Tensor, "b v 4 4"]) -> SeenTokens:
        views = c2w.shape[1]
        starts = np.concatenate([[0], np.cumsum(scene.segments.lengths)])
        rows = np.concatenate(
            [np.tile(np.arange(n) + start, views) for start, n in zip(starts, scene.segments.lengths, strict=False)]
        )
        rows = on_device(rows, c2w.device)
        segments = Segments.from_lengths([n for n in scene.segments.lengths for _ in range(views)], c2w.device)
        camera = c2w.flatten(0, 1)[segments.index]
        points = to_camera(scene.points[rows].unflatten(-1, (3, 3)), camera)
        return cls(rows, points.flatten(1), segments)
