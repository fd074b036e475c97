"""Exposure: the brightness at which a network sees a scene. Light is linear, so the image scales back exactly."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.model.tokenizer import mean_by_object, object_areas


class UnitExposure:
    """Every scene as it is (the paper's): the network itself has to learn how bright its lights are."""

    def __call__(self, batch: RaggedBatch) -> Float[Tensor, " b"]:
        return torch.ones(len(batch.scenes), device=batch.positions.device)


class ArrivingLight:
    """Every scene at the brightness of what its lights send to its surfaces, if nothing stood in the way.

    Not in the paper. A light's orientation changes how much of it arrives more than its strength does, and a small
    data set is too small to learn that product of three factors first. Twice the light then gives exactly twice
    the image.

    A small triangle of area A and normal n that emits radiance L sends L A |n·v| / |v|³ to a surface facing it at v
    (two-sided). An object of surface a is taken for a disc of that area around its centroid, radius² ρ² = a/π, turned
    anyhow: its mean square of n·v is (n·v)² + ρ²/6, and |v|² becomes |v|² + ρ², so that nothing is infinite where
    light and object touch, or zero where a light is seen edge-on. Summed over lights, averaged over the scene's
    non-emitting objects by area.
    """

    def __call__(self, batch: RaggedBatch) -> Float[Tensor, " b"]:
        """[B] radiance; 1 for a scene without light, or with nothing to light."""
        area, emission = object_areas(batch), batch.material[:, 7:10].mean(-1)
        lit = (mean_by_object(emission[:, None], batch)[:, 0] == 0) * area  # [O] area, zero for emitters
        centroid = mean_by_object(batch.positions.mean(1), batch)

        # pairs of an emitting triangle and an object of its scene
        emitters = torch.nonzero(emission)[:, 0]
        scene = batch.scenes.index[batch.objects.index[emitters]]
        first, count = batch.scenes.offsets[scene].long(), batch.scenes.offsets[scene + 1] - batch.scenes.offsets[scene]
        pair = torch.repeat_interleave(torch.arange(len(emitters), device=emitters.device), count)
        target = torch.arange(len(pair), device=pair.device) - (count.cumsum(0) - count)[pair] + first[pair]

        corners = batch.positions[emitters]
        vector_area = 0.5 * torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        way = centroid[target] - corners.mean(1)[pair]
        radius2 = area[target] / torch.pi
        height2 = (vector_area[pair] * way).sum(-1).square() + batch.areas[emitters][pair].square() * radius2 / 6
        arriving = emission[emitters][pair] * height2.sqrt() / (way.square().sum(-1) + radius2) ** 1.5

        total = arriving.new_zeros(len(batch.scenes)).index_add(0, scene[pair], arriving * lit[target])
        surface = total.new_zeros(len(batch.scenes)).index_add(0, batch.scenes.index, lit)
        exposure = total / surface
        return torch.where((total > 0) & (surface > 0), exposure, 1.0)
