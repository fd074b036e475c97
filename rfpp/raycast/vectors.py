"""Vectors of three numbers, one at a time, for compiled loops."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rfpp.raycast.compiled import compiled, float64

#: A vector in registers; and any three numbers, of an array too.
Triple = tuple[float, float, float]
Vector = Triple | np.ndarray
#: No light.
BLACK = (0.0, 0.0, 0.0)
#: Multiples of it, modulo 1, spread evenly over the unit interval however many they are.
GOLDEN = 0.6180339887498949


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Their scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def added(a: Vector, b: Vector) -> Triple:
    """Their sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def scaled(a: Vector, factor: float) -> Triple:
    """A multiple."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@compiled
def cross(a: Vector, b: Vector) -> Triple:
    """Their vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def product(a: Vector, b: Vector) -> Triple:
    """Color by color."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@compiled
def mean(a: Vector) -> float:
    """Of three colors."""
    return (a[0] + a[1] + a[2]) / 3


@compiled
def triple(row: Float[np.ndarray, " 3"]) -> Triple:
    """Three numbers of an array, as a vector in registers."""
    return float64(row[0]), float64(row[1]), float64(row[2])


@compiled
def in_world(vector: Vector, first: Vector, second: Vector, normal: Vector) -> Triple:
    """The vector with these parts along two tangents and a normal."""
    x, y, z = vector
    return (
        x * first[0] + y * second[0] + z * normal[0],
        x * first[1] + y * second[1] + z * normal[1],
        x * first[2] + y * second[2] + z * normal[2],
    )


@compiled
def unit(x: float, y: float, z: float) -> Triple:
    """The vector's direction."""
    length = max(np.sqrt(x * x + y * y + z * z), 1e-20)
    return x / length, y / length, z / length


@compiled
def tangents(normal: Vector) -> tuple[Triple, Triple]:
    """Two, with which a unit normal is a frame (Duff et al., "Building an Orthonormal Basis, Revisited", 2017).

    Those of an upright wall are alike in all its pixels, whichever way rounding tips it: rays are spread over several.
    """
    x, y, z = normal
    sign = -1.0 if z < -0.5 else 1.0
    a = -1 / (sign + z)
    b = x * y * a
    return (1 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


@compiled
def in_frame(vector: Vector, first: Vector, second: Vector, normal: Vector) -> Triple:
    """The vector's parts along two tangents and a normal."""
    x, y, z = vector
    along = x * normal[0] + y * normal[1] + z * normal[2]
    return x * first[0] + y * first[1] + z * first[2], x * second[0] + y * second[1] + z * second[2], along


@compiled
def normal_of(a: Vector, b: Vector, c: Vector) -> Triple:
    """Along the normal of a triangle, as long as twice its area."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
