"""Operations on single 3-vectors for compiled loops."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rfpp.raycast.compiled import compiled, float64

#: A vector in registers; and a vector or a row of an array.
Triple = tuple[float, float, float]
Vector = Triple | np.ndarray
#: No light.
BLACK = (0.0, 0.0, 0.0)
#: Any number of its multiples, modulo 1, is spread evenly over the unit interval.
GOLDEN = 0.6180339887498949


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def added(a: Vector, b: Vector) -> Triple:
    """Return the sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def scaled(a: Vector, factor: float) -> Triple:
    """Return a multiple."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@compiled
def cross(a: Vector, b: Vector) -> Triple:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def product(a: Vector, b: Vector) -> Triple:
    """Return the componentwise product."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@compiled
def mean(a: Vector) -> float:
    """Return the mean of three components."""
    return (a[0] + a[1] + a[2]) / 3


@compiled
def triple(row: Float[np.ndarray, " 3"]) -> Triple:
    """Return a row of an array as a vector in registers."""
    return float64(row[0]), float64(row[1]), float64(row[2])


@compiled
def camera_axes(pose: Float[np.ndarray, "4 4"]) -> tuple[Triple, Triple, Triple, Triple]:
    """Return the columns of a camera's pose: right, up, backward and position."""
    return (
        (pose[0, 0], pose[1, 0], pose[2, 0]),
        (pose[0, 1], pose[1, 1], pose[2, 1]),
        (pose[0, 2], pose[1, 2], pose[2, 2]),
        (pose[0, 3], pose[1, 3], pose[2, 3]),
    )


@compiled
def in_world(vector: Vector, first: Vector, second: Vector, normal: Vector) -> Triple:
    """Transform a vector from the frame of two tangents and a normal to world space."""
    x, y, z = vector
    return (
        x * first[0] + y * second[0] + z * normal[0],
        x * first[1] + y * second[1] + z * normal[1],
        x * first[2] + y * second[2] + z * normal[2],
    )


@compiled
def unit(x: float, y: float, z: float) -> Triple:
    """Return the unit vector."""
    length = max(np.sqrt(x * x + y * y + z * z), 1e-20)
    return x / length, y / length, z / length


@compiled
def tangents(normal: Vector) -> tuple[Triple, Triple]:
    """Return two tangents that complete a unit normal to a frame.

    Duff et al., "Building an Orthonormal Basis, Revisited", 2017. All pixels of a vertical wall get the same tangents,
    whatever the rounding of its normal, because neighbors share their rays.
    """
    x, y, z = normal
    sign = -1.0 if z < -0.5 else 1.0
    a = -1 / (sign + z)
    b = x * y * a
    return (1 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


@compiled
def in_frame(vector: Vector, first: Vector, second: Vector, normal: Vector) -> Triple:
    """Transform a vector from world space to the frame of two tangents and a normal."""
    x, y, z = vector
    along = x * normal[0] + y * normal[1] + z * normal[2]
    return x * first[0] + y * first[1] + z * first[2], x * second[0] + y * second[1] + z * second[2], along


@compiled
def normal_of(a: Vector, b: Vector, c: Vector) -> Triple:
    """Return a triangle's normal with a length of twice its area."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
