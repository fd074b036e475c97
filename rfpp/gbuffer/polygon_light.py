"""How much light a triangle that shines evenly sends to a point: Lambert's formula, exact, horizon included."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rfpp.gbuffer.compiled import compiled
from rfpp.gbuffer.vectors import BLACK, Triple, Vector, added, dot, scaled


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
    a, b, c = _away(point, corners[0]), _away(point, corners[1]), _away(point, corners[2])
    above_a, above_b, above_c = dot(a, normal), dot(b, normal), dot(c, normal)
    if above_a <= 0 and above_b <= 0 and above_c <= 0:
        return 0.0
    if above_a > 0 and above_b > 0 and above_c > 0:
        return abs(_edge(a, b, normal) + _edge(b, c, normal) + _edge(c, a, normal)) / (2 * np.pi)
    total, leaving, entering = 0.0, BLACK, BLACK
    for _ in range(3):
        if above_a > 0 or above_b > 0:
            first, second = a, b
            if above_a <= 0 or above_b <= 0:
                share = above_a / (above_a - above_b)
                crossing = added(a, scaled(added(b, scaled(a, -1.0)), share))
                if above_a > 0:
                    second = leaving = crossing
                else:
                    first = entering = crossing
            total += _edge(first, second, normal)
        a, b, c, above_a, above_b, above_c = b, c, a, above_b, above_c, above_a
    return abs(total + _edge(leaving, entering, normal)) / (2 * np.pi)


@compiled
def _away(point: Vector, corner: Vector) -> Triple:
    return corner[0] - point[0], corner[1] - point[1], corner[2] - point[2]


def _fitted(degree: int) -> tuple[float, ...]:
    """Coefficients of a polynomial in x that is arccos(x) / sin(arccos(x)) for x in [0, 1], highest power first."""
    middle = (np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1)) + 1) / 2  # Chebyshev's points
    angle = np.arccos(middle)
    return tuple(np.polyfit(middle, angle / np.sin(angle), degree).tolist())


#: To 4e-9; with arctangents direct light takes a twentieth longer.
_ANGLE_OVER_SINE = _fitted(10)


@compiled
def _edge(a: Vector, b: Vector, normal: Vector) -> float:
    """angle(a, b) · (unit a × b) · normal."""
    across = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    scale = 1 / np.sqrt(max(dot(a, a) * dot(b, b), 1e-60))
    cosine, ratio = dot(a, b) * scale, 0.0
    for coefficient in _ANGLE_OVER_SINE:
        ratio = ratio * min(abs(cosine), 1.0) + coefficient
    if cosine < 0:  # π less the angle to -b; the sine of a × b, which 1 - cosine² would lose beside an edge
        ratio = np.pi / max(np.sqrt(dot(across, across)) * scale, 1e-30) - ratio
    found: float = dot(across, normal) * scale * ratio
    return found
