"""Uniform sampling of the solid angle of a triangle (Arvo, "Stratified Sampling of Spherical Triangles", 1995)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from rfpp.raycast.compiled import compiled
from rfpp.raycast.vectors import Triple, Vector, added, cross, dot, scaled, unit


@compiled
def solid_angle(point: Vector, corners: Float[np.ndarray, "3 3"]) -> float:
    """Return the solid angle of a triangle in steradians (Van Oosterom and Strackee 1983)."""
    a, b, c = _toward(point, corners[0]), _toward(point, corners[1]), _toward(point, corners[2])
    volume = abs(dot(a, cross(b, c)))
    angle: float = 2 * np.arctan2(volume, 1 + dot(a, b) + dot(b, c) + dot(c, a))
    return angle


@compiled
def direction_within(point: Vector, corners: Float[np.ndarray, "3 3"], u: float, v: float) -> Triple:
    """Return the direction to a point of a triangle; uniform over its solid angle for uniform u and v."""
    a, b, c = _toward(point, corners[0]), _toward(point, corners[1]), _toward(point, corners[2])
    plane_ab, plane_bc, plane_ca = unit(*cross(a, b)), unit(*cross(b, c)), unit(*cross(c, a))
    cosine, sine = _angle(plane_ab, scaled(plane_ca, -1.0))
    angle = np.arctan2(sine, cosine)
    excess = angle + _radians(plane_bc, scaled(plane_ab, -1.0)) + _radians(plane_ca, scaled(plane_bc, -1.0))
    # the triangle a, b, c' whose area is u times that of the whole
    phi = np.pi + u * (excess - np.pi)
    sin_phi = np.sin(phi) * cosine - np.cos(phi) * sine
    cos_phi = np.cos(phi) * cosine + np.sin(phi) * sine
    k, m = cos_phi + cosine, sin_phi - sine * dot(a, b)
    cos_side = (m + (m * cos_phi - k * sin_phi) * cosine) / ((m * sin_phi + k * cos_phi) * sine)
    cos_side = min(max(cos_side, -1.0), 1.0)
    third = added(scaled(a, cos_side), scaled(_across(c, a), np.sqrt(max(1 - cos_side * cos_side, 0.0))))
    cos_arc = min(max(1 - v * (1 - dot(third, b)), -1.0), 1.0)
    arc = added(scaled(b, cos_arc), scaled(_across(third, b), np.sqrt(max(1 - cos_arc * cos_arc, 0.0))))
    return unit(arc[0], arc[1], arc[2])


@compiled
def _toward(point: Vector, corner: Vector) -> Triple:
    return unit(corner[0] - point[0], corner[1] - point[1], corner[2] - point[2])


@compiled
def _across(vector: Vector, axis: Vector) -> Triple:
    """Return the unit vector in the plane of both that is perpendicular to the axis."""
    rest = added(vector, scaled(axis, -dot(vector, axis)))
    return unit(rest[0], rest[1], rest[2])


@compiled
def _angle(a: Vector, b: Vector) -> tuple[float, float]:
    cosine = min(max(dot(a, b), -1.0), 1.0)
    return cosine, np.sqrt(max(1 - cosine * cosine, 0.0))


@compiled
def _radians(a: Vector, b: Vector) -> float:
    cosine, sine = _angle(a, b)
    angle: float = np.arctan2(sine, cosine)
    return angle
