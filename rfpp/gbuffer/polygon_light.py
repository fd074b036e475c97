"""How much light a triangle that shines evenly sends to a point: Lambert's formula, exact, horizon included."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rfpp.gbuffer.compiled import compiled
from rfpp.gbuffer.vectors import Triple, Vector


def form_factor(
    points: Float[np.ndarray, "r 3"], normals: Float[np.ndarray, "r 3"], corners: Float[np.ndarray, "e 3 3"]
) -> Float[np.ndarray, "r e"]:
    """Irradiance / (π · radiance) at each point from each triangle with nothing in between, from either of its sides.

    The part of a triangle below the horizon of `normals` sends nothing. The sum of angle · (unit normal of the
    plane through the point and an edge) over the edges of the visible part, along the surface normal, over 2π; where
    the horizon cuts the triangle, the cut is one more edge (Lambert 1760; Baum et al. 1989 for the clipping).
    """
    factors = np.empty((len(points), len(corners)))
    points, normals, corners = (np.ascontiguousarray(x, np.float64) for x in (points, normals, corners))
    _each(points, normals, corners, factors)
    return factors


@compiled
def _each(
    points: Float[np.ndarray, "r 3"],
    normals: Float[np.ndarray, "r 3"],
    corners: Float[np.ndarray, "e 3 3"],
    factors: Float[np.ndarray, "r e"],
) -> None:
    for row in range(len(points)):
        for triangle in range(len(corners)):
            factors[row, triangle] = of_triangle(points[row], normals[row], corners[triangle])


@compiled
def of_triangle(point: Vector, normal: Vector, corners: Float[np.ndarray, "3 3"]) -> float:
    """See `form_factor`: of one triangle at one point."""
    total = 0.0
    leaving, entering = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    cut = False
    for k in range(3):
        a, ha = _seen(point, normal, corners[k])
        b, hb = _seen(point, normal, corners[(k + 1) % 3])
        if ha <= 0 and hb <= 0:
            continue
        if (ha > 0) != (hb > 0):
            share, cut = ha / (ha - hb), True
            crossing = a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share
            if ha > 0:
                b = leaving = crossing
            else:
                a = entering = crossing
        total += _edge(a, b, normal)
    if cut:
        total += _edge(leaving, entering, normal)
    return abs(total) / (2 * np.pi)


@compiled
def _seen(point: Vector, normal: Vector, corner: Vector) -> tuple[Triple, float]:
    """The corner from the point, and its height above the horizon."""
    x, y, z = corner[0] - point[0], corner[1] - point[1], corner[2] - point[2]
    return (x, y, z), x * normal[0] + y * normal[1] + z * normal[2]


@compiled
def _edge(a: Vector, b: Vector, normal: Vector) -> float:
    """angle(a, b) · (unit a × b) · normal."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    size: float = np.sqrt(x * x + y * y + z * z)
    angle: float = np.arctan2(size, a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
    return (x * normal[0] + y * normal[1] + z * normal[2]) * angle / max(size, 1e-30)
