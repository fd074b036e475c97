"""What a ray token is told about the lights: nothing, or where light would come from if nothing stood in its way."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.model.camera_space import to_camera


@dataclass(frozen=True)
class Emitters:
    """The emitting triangles of B scenes, packed scene by scene.

    Attributes:
        corners: [E, 3, 3] world space.
        radiance: [E] emitted radiance, mean over colour.
        first, count: [B] where each scene's begin, and how many they are.
    """

    corners: Float[Tensor, "e 3 3"]
    radiance: Float[Tensor, " e"]
    first: Int[Tensor, " b"]
    count: Int[Tensor, " b"]

    @classmethod
    def of(cls, batch: RaggedBatch) -> Emitters:
        radiance = batch.material[:, 7:10].mean(-1)
        emitting = torch.nonzero(radiance)[:, 0]
        scene = batch.scenes.index[batch.objects.index[emitting]]
        count = torch.bincount(scene, minlength=len(batch.scenes))
        return cls(batch.positions[emitting], radiance[emitting], count.cumsum(0) - count, count)


class NoLight:
    """Ray tokens learn of the lights from the scene's tokens alone (the paper's)."""

    #: Maps it adds to the ray bundles.
    maps = 0
    #: What it needs of the G-buffer.
    channels: tuple[str, ...] = ()

    def emitters(self, batch: RaggedBatch) -> None:
        return None

    def __call__(
        self, emitters: None, c2w: Float[Tensor, "b v 4 4"], gbuffer: Float[Tensor, "n 0 h w"]
    ) -> Float[Tensor, "n 0 h w"]:
        return gbuffer


class UnshadowedLight:
    """The light that would reach each first hit if nothing stood in between, and the direction it would come from.

    Not in the paper. A small data set teaches a network the law of light at a surface slowly, and longer training on
    it learns the scenes by heart instead. No rays are cast: shadows, reflections and every further bounce remain the
    network's to predict.

    Per emitting triangle of radiance L, area A and normal n, with unit direction w and distance r from hit to
    centroid: the amount L A |n·w| / (r² + A/π), which stays finite where the two touch.
    """

    maps = 4
    channels: tuple[str, ...] = ("normal", "position")

    def emitters(self, batch: RaggedBatch) -> Emitters:
        """What it needs of the scenes, whatever the view."""
        return Emitters.of(batch)

    def __call__(
        self, emitters: Emitters, c2w: Float[Tensor, "b v 4 4"], gbuffer: Float[Tensor, "n 6 h w"]
    ) -> Float[Tensor, "n 4 h w"]:
        """Σ amount · w in camera space (3), then Σ amount · max(0, normal · w); zero where nothing is hit."""
        views, camera = c2w.shape[1], c2w.flatten(0, 1)
        normal, position = gbuffer.chunk(2, dim=1)
        vector, irradiance = torch.zeros_like(position), torch.zeros_like(position[:, :1])
        for k in range(int(emitters.count.max())):  # the k-th emitter of every scene at once
            there = k < emitters.count
            row = torch.where(there, emitters.first + k, 0)
            corners = to_camera(emitters.corners[row].repeat_interleave(views, 0), camera)
            a, b, c = corners[..., None, None].unbind(1)  # [N, 3, 1, 1]
            vector_area = 0.5 * torch.linalg.cross(b - a, c - a, dim=1)
            area = torch.linalg.vector_norm(vector_area, dim=1, keepdim=True)
            way = (a + b + c) / 3 - position
            distance2 = way.square().sum(1, keepdim=True) + area / torch.pi
            direction = way * distance2.rsqrt()
            radiance = torch.where(there, emitters.radiance[row], 0).repeat_interleave(views)[:, None, None, None]
            amount = radiance * (vector_area * direction).sum(1, keepdim=True).abs() / distance2
            vector = vector + amount * direction
            irradiance = irradiance + amount * (direction * normal).sum(1, keepdim=True).clamp_min(0)
        hit = position[:, 2:] < 0  # what the camera sees lies at negative z
        return torch.cat([vector, irradiance], dim=1) * hit
