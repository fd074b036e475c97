"""Global deformations of solids (Barr 1984): twist, taper and bend about the z axis.

Each is one-to-one on the solid's bounding box, so that a closed solid stays closed, keeps its orientation and does not
intersect itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.objects.solid import Rng, from_manifold, to_manifold

Points = Float[np.ndarray, "points 3"]
#: Draws a map of the box [-half, half] (half [3]) to space.
Deformation = Callable[[Rng, np.ndarray], Callable[[Points], Points]]

#: Meshes with at least this share of the target faces are deformed without refinement.
_FINE = 0.8


def twist(rng: Rng, half: np.ndarray) -> Callable[[Points], Points]:
    """Draw a rotation about z that grows with z, by 30 to 100 degrees in total, in either direction."""
    rate = np.radians(rng.uniform(30, 100)) * rng.choice([-1.0, 1.0]) / (2 * half[2])

    def twisted(points: Points) -> Points:
        angle = rate * points[:, 2]
        x, y = points[:, 0], points[:, 1]
        return np.stack(
            [x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), points[:, 2]], axis=1
        )

    return twisted


def taper(rng: Rng, half: np.ndarray) -> Callable[[Points], Points]:
    """Draw a scaling across z that decreases along z from 1 to between 0.25 and 0.7."""
    slope = 1 - rng.uniform(0.25, 0.7)

    def tapered(points: Points) -> Points:
        factor = 1 - slope * (points[:, 2:] / half[2] + 1) / 2
        return np.concatenate([factor * points[:, :2], points[:, 2:]], axis=1)

    return tapered


def bend(rng: Rng, half: np.ndarray) -> Callable[[Points], Points]:
    """Draw a bend of the z axis to an arc about y, by 40 to 130 degrees or as far as the solid's width allows."""
    # the arc's center must lie outside the solid: radius = length / angle > half the width
    angle = min(rng.uniform(np.radians(40), np.radians(130)), 0.8 * 2 * half[2] / half[0])
    radius = 2 * half[2] / angle

    def bent(points: Points) -> Points:
        phi = points[:, 2] / radius
        reach = radius - points[:, 0]
        return np.stack([radius - reach * np.cos(phi), points[:, 1], reach * np.sin(phi)], axis=1)

    return bent


#: Deformations by name.
DEFORMATIONS: dict[str, Deformation] = {deformation.__name__: deformation for deformation in (twist, taper, bend)}


def deformed(rng: Rng, mesh: Mesh, target_faces: int) -> Mesh:
    """Apply a random deformation along the longest side of a closed mesh, before decimation to `target_faces`."""
    deformation = list(DEFORMATIONS.values())[int(rng.integers(len(DEFORMATIONS)))]
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    # a cyclic permutation of axes is a rotation, so the orientation is kept
    order = np.roll(np.arange(3), 2 - int(np.argmax(high - low)))
    centered = Mesh((mesh.vertices - (low + high) / 2)[:, order], mesh.faces)
    fine = centered if len(mesh) >= _FINE * target_faces else _with_short_edges(centered, target_faces)
    return Mesh(deformation(rng, (high - low)[order] / 2)(fine.vertices.astype(np.float64)), fine.faces)


def _with_short_edges(mesh: Mesh, faces: int) -> Mesh:
    """Refine a surface to edges no longer than those of `faces` equilateral triangles, so that flat sides can curve."""
    solid = to_manifold(mesh)
    return from_manifold(solid.refine_to_length(math.sqrt(4 / math.sqrt(3) * solid.surface_area() / faces)))
