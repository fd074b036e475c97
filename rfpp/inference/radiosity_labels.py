"""Training data in minutes: scenes labeled by radiosity, while held-out splits are path-traced."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from rfpp.inference.plan import Plan
from rfpp.inference.radiosity_engine import RadiosityEngine
from rfpp.radiosity.cell_places import even_points
from rfpp.radiosity.cell_tensors import CellTensors
from rfpp.radiosity.radiosity import Radiosity
from rfpp.ranges import NonNegative, Positive
from rfpp.reference import cycles
from rfpp.reference.labels import Labels
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import SceneTriangles

#: Octants of directions, numbered by the signs of x, y and z.
OCTANTS = 8


@dataclass(frozen=True)
class RadiosityLabels:
    """Labels by unrefined radiosity for the split `train`, by Cycles for all others. Values are in conf/reference.

    Attributes:
        held_out: Cycles settings of the other splits.
        light_samples: Shadow rays per light and pixel.
        points: Samples along each side of a pixel.
        token_bounces: K, bounces after which the light of surfaces is stored; None stores none.
        seed: Part of Cycles' seeds.
    """

    held_out: cycles.CyclesSettings
    light_samples: Positive
    points: Positive
    token_bounces: NonNegative | None
    seed: NonNegative

    def labels(
        self,
        split: str,
        triangles: SceneTriangles,
        c2w: Float[np.ndarray, "v 4 4"],
        fov: Float[np.ndarray, " v"],
        resolution: int,
        noise: int,
    ) -> Labels:
        """Return the labels of square views; `noise` seeds Cycles."""
        if split != "train":
            settings = replace(self.held_out, seed=noise)
            return Labels(cycles.render(triangles, c2w, fov, resolution, resolution, settings))
        engine = RadiosityEngine(Radiosity(), torch.device("cpu"), torch.float32)
        scene = PackedScene("labeled", triangles, c2w, fov)
        plan = Plan(scene, (resolution, resolution), self.light_samples, self.points)
        images = np.stack(list(engine.views(plan)))
        if self.token_bounces is None:
            return Labels(images)
        return Labels(images, token_light(engine, triangles, self.token_bounces))


def token_light(engine: RadiosityEngine, triangles: SceneTriangles, bounces: int) -> Float[np.ndarray, "o 8 k 3"]:
    """Return the light at the surfaces of each object; see `Labels.token_light`."""
    cells, _ = engine.source.cells(triangles)
    states = engine.module.solve(CellTensors.of(cells, torch.device("cpu")), bounces)
    at_cells = np.stack([cells.direct + lit.indirect.numpy() for lit in states], axis=1)  # [C, K + 1, 3]

    cell_map = engine.source.cell_map(triangles)
    points = even_points(triangles, cell_map.grid, np.random.default_rng(0))
    cell = cell_map.at(points.triangle, points.position, points.back)
    reached = np.flatnonzero(cell >= 0)  # no light can reach the inside of a closed object
    cell, points = cell[reached], points.part(reached)

    octant = (points.normal(triangles) > 0) @ np.array([1, 2, 4])
    rows = OCTANTS * triangles.object_index[points.triangle] + octant
    sums = np.zeros((OCTANTS * triangles.num_objects, *at_cells.shape[1:]))
    np.add.at(sums, rows, at_cells[cell])
    counts = np.bincount(rows, minlength=len(sums))[:, None, None]
    means = np.where(counts > 0, sums / counts.clip(1), np.nan)  # the points of an object stand for equal areas
    return means.reshape(triangles.num_objects, OCTANTS, *sums.shape[1:]).astype(np.float32)
