"""How much light a triangle that shines evenly sends to a point: Lambert's formula, exact, horizon included."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def form_factor(
    points: Float[np.ndarray, "r 3"], normals: Float[np.ndarray, "r 3"], corners: Float[np.ndarray, "e 3 3"]
) -> Float[np.ndarray, "r e"]:
    """Irradiance / (π · radiance) at each point from each triangle with nothing in between, from either of its sides.

    The part of a triangle below the horizon of `normals` sends nothing. The sum of angle · (unit normal of the
    plane through the point and an edge) over the edges of the visible part, along the surface normal, over 2π; where
    the horizon cuts the triangle, the cut is one more edge (Lambert 1760; Baum et al. 1989 for the clipping).
    """
    to_corner = corners[None] - points[:, None, None]  # [R, E, 3, 3]
    height = np.einsum("reck,rk->rec", to_corner, normals)
    total = np.zeros(height.shape[:2])
    leaving, entering = np.zeros_like(to_corner[:, :, 0]), np.zeros_like(to_corner[:, :, 0])
    for k in range(3):
        a, b = to_corner[:, :, k], to_corner[:, :, (k + 1) % 3]
        ha, hb = height[:, :, k, None], height[:, :, (k + 1) % 3, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = a + (b - a) * (ha / (ha - hb))  # used only where the signs differ
        down, up = (ha > 0) & (hb <= 0), (ha <= 0) & (hb > 0)
        leaving, entering = np.where(down, crossing, leaving), np.where(up, crossing, entering)
        start, end = np.where(up, crossing, a), np.where(down, crossing, b)
        term = _edge(start, end, normals)
        total += np.where(((ha > 0) | (hb > 0))[..., 0], term, 0)
    cut = (height > 0).any(-1) & (height <= 0).any(-1)
    total += np.where(cut, _edge(leaving, entering, normals), 0)
    return np.abs(total) / (2 * np.pi)


def _edge(
    a: Float[np.ndarray, "r e 3"], b: Float[np.ndarray, "r e 3"], normals: Float[np.ndarray, "r 3"]
) -> Float[np.ndarray, "r e"]:
    """angle(a, b) · (unit a × b) · normal."""
    cross = np.cross(a, b)
    size = np.linalg.norm(cross, axis=-1)
    angle = np.arctan2(size, (a * b).sum(-1))
    return np.einsum("rek,rk->re", cross, normals) * angle / np.maximum(size, 1e-30)
