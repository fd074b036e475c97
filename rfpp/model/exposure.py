"""Exposure: the brightness at which a network sees a scene. Light is linear, so the image scales back exactly."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.model.hoct import mean_by_object, object_areas
from rfpp.segments import on_device


class UnitExposure:
    """Exposure 1 for every scene (the paper's): the network has to learn the brightness of lights."""

    def __call__(self, batch: RaggedBatch) -> Float[Tensor, " b"]:
        return torch.ones(len(batch.scenes), device=batch.positions.device)


class MeanIrradianceExposure:
    """Normalize each scene to the mean irradiance that its lights would cause without occlusion.

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
        """Return the exposure [B] in units of radiance; 1 for scenes without light or lit surfaces."""
        area, emission = object_areas(batch), batch.material[:, 7:10].mean(-1)
        lit = (mean_by_object(emission[:, None], batch)[:, 0] == 0) * area  # [O] area, zero for emitters
        centroid = mean_by_object(batch.positions.mean(1), batch)

        emitter, target = (on_device(rows, area.device) for rows in emitters_and_objects(batch))
        corners = batch.positions[emitter]
        vector_area = 0.5 * torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        direction = centroid[target] - corners.mean(1)
        radius2 = area[target] / torch.pi
        height2 = (vector_area * direction).sum(-1).square() + batch.areas[emitter].square() * radius2 / 6
        arriving = emission[emitter] * height2.sqrt() / (direction.square().sum(-1) + radius2) ** 1.5

        scene = batch.scenes.index[target]
        total = arriving.new_zeros(len(batch.scenes)).index_add(0, scene, arriving * lit[target])
        surface = total.new_zeros(len(batch.scenes)).index_add(0, batch.scenes.index, lit)
        exposure = total / surface
        return torch.where((total > 0) & (surface > 0), exposure, 1.0)


def emitters_and_objects(batch: RaggedBatch) -> tuple[Int[np.ndarray, " pairs"], Int[np.ndarray, " pairs"]]:
    """Return all pairs of an emitting triangle and an object of its scene, as rows of triangles and of objects."""
    last_triangles, last_objects = np.cumsum(batch.objects.lengths), np.cumsum(batch.scenes.lengths)
    owner = np.searchsorted(last_triangles, batch.emitters, side="right")
    scene = np.searchsorted(last_objects, owner, side="right")
    count = np.array(batch.scenes.lengths)[scene]
    emitter = np.repeat(batch.emitters, count)
    nth = np.arange(len(emitter)) - np.repeat(np.cumsum(count) - count, count)
    return emitter, np.repeat(last_objects[scene] - count, count) + nth
