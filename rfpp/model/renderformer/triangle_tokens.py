"""RenderFormer's scene tokens: one per triangle, after the registers of its scene."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.model.layers.scene_tokens import SceneTokens
from rfpp.ranges import NonNegative, Positive


class TriangleTokens(nn.Module):
    """One token per triangle, preceded by learned register tokens.

    Args:
        width: Token width D.
        registers: Registers per scene, placed at the mean of its vertices (RenderFormer has 16).
    """

    def __init__(self, width: Positive, registers: NonNegative):
        super().__init__()
        self.registers = nn.Parameter(torch.empty(registers, width).normal_(std=0.02))

    def forward(self, triangles: Float[Tensor, "m width"], batch: RaggedBatch) -> SceneTokens:
        device, scenes, registers = triangles.device, len(batch.scenes), len(self.registers)
        per_scene = batch.objects.grouped(batch.scenes)
        center = batch.positions.new_zeros(scenes, 3).index_add(0, per_scene.index, batch.positions.mean(1))
        center = center / per_scene.sizes.clamp_min(1)[:, None]

        # all registers, then all triangles, sorted into registers and triangles of the first scene, of the second, …
        owner = torch.cat([torch.arange(scenes, device=device).repeat_interleave(registers), per_scene.index])
        order = owner.argsort(stable=True)
        points = torch.cat([center.repeat(1, 3).repeat_interleave(registers, 0), batch.positions.flatten(1)])
        no_emission = batch.log_emission.new_zeros(scenes * registers, 3)
        return SceneTokens(
            features=torch.cat([self.registers.to(triangles.dtype).repeat(scenes, 1), triangles])[order],
            points=points[order],
            log_emission=torch.cat([no_emission, batch.log_emission])[order],
            segments=per_scene.lengthened(registers),
        )
