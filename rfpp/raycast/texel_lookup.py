"""Texels at points of triangles (`rfpp.scene.texels`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float, Int

from rfpp.raycast.compiled import compiled, float64, int64
from rfpp.raycast.threads import over_rows
from rfpp.raycast.vectors import (
    Vector,
    added,
    camera_axes,
    cross,
    dot,
    in_frame,
    in_world,
    normal_of,
    scaled,
    triple,
    unit,
)
from rfpp.scene.camera import pixel_plane
from rfpp.scene.texels import NORMAL, Texels

_NORMAL = NORMAL.start


@dataclass(frozen=True, eq=False)
class SeenTexels:
    """Texels at the hits of a G-buffer.

    Attributes:
        row: Row of `values`, -1 where a triangle has one material or is too small for its texels to be seen.
        values: `rfpp.scene.texels.Texels.values`.
    """

    row: Int[np.ndarray, "h w"]
    values: Float[np.ndarray, "t 10"]

    def replaced(
        self, of_triangles: Float[np.ndarray, "*hits c"], columns: slice, hits: Int[np.ndarray, " n"] | None = None
    ) -> Float[np.ndarray, "*hits c"]:
        """Return columns of materials with those of texels in place of those of triangles.

        Args:
            of_triangles: Columns of the triangles' materials at all pixels, or at `hits`; overwritten.
            hits: Numbers of pixels, row by row.
        """
        row = self.row if hits is None else self.row.reshape(-1)[hits]
        fine = row >= 0
        of_triangles[fine] = self.values[row[fine], columns]
        return of_triangles


def find_texels(
    texels: Texels,
    positions: Float[np.ndarray, "m 3 3"],
    triangle: Int[np.ndarray, "h w"],
    normal: Float[np.ndarray, "h w 3"],
    depth: Float[np.ndarray, "h w"],
    c2w: Float[np.ndarray, "4 4"],
    fov: SupportsFloat,
    points: int,
) -> SeenTexels:
    """Return the texels at first hits, about as large as a pixel; normals follow their maps.

    Args:
        texels, positions: Arrays of `rfpp.scene.triangles.SceneTriangles`.
        triangle, normal, depth: Arrays of `rfpp.raycast.first_hit.GBuffer`; the normals are changed.
    """
    row, (height, width) = np.full(triangle.shape, -1, np.int32), triangle.shape
    plane, slope = pixel_plane(height, width, points).reshape(-1, 2), np.tan(np.radians(float(fov)) / 2)
    pixel = 2 * slope / max(height, width)
    table = positions, texels.level, texels.first, texels.values
    view = plane, slope, pixel, c2w.astype(np.float64)
    over_rows(row.size, _find, *table, *view, triangle.reshape(-1), depth.reshape(-1), normal.reshape(-1, 3),
              row.reshape(-1))  # fmt: skip
    return SeenTexels(row, texels.values)


@compiled
def _find(
    start: int,
    stop: int,
    positions: Float[np.ndarray, "m 3 3"],
    level: Int[np.ndarray, " m"],
    first: Int[np.ndarray, " m"],
    values: Float[np.ndarray, "t 10"],
    plane: Float[np.ndarray, "pixels 2"],
    slope: float,
    pixel: float,
    pose: Float[np.ndarray, "4 4"],
    triangle: Int[np.ndarray, " pixels"],
    depth: Float[np.ndarray, " pixels"],
    normal: Float[np.ndarray, "pixels 3"],
    row: Int[np.ndarray, " pixels"],
) -> None:
    """Fill in the rows, and change the normals; `pixel` is the side of a pixel at distance 1."""
    right, up, back, eye = camera_axes(pose)
    for at in range(start, stop):
        hit, far = triangle[at], float64(depth[at])
        if hit < 0 or level[hit] == 0:
            continue
        toward = (far * slope * plane[at, 0], far * slope * plane[at, 1], -far)
        point = added(eye, in_world(toward, right, up, back))
        corners = triple(positions[hit, 0]), triple(positions[hit, 1]), triple(positions[hit, 2])
        u, v = weights_at(*corners, point)
        across = normal_of(*corners)
        area = np.sqrt(dot(across, across)) / 2
        ahead = unit(*toward)
        cosine = abs(dot(in_frame(across, right, up, back), ahead)) / max(2 * area, 1e-30)
        row[at] = texel_at(level, first, hit, u, v, area, far * far * pixel * pixel / max(cosine, 0.05))
        if row[at] < 0:
            continue
        x, y, z = triple(values[row[at], _NORMAL:])
        if z > 0.9999:
            continue
        shading = triple(normal[at])
        side = -1.0 if dot(in_frame(across, right, up, back), shading) < 0 else 1.0
        shading = scaled(shading, side)
        edge = in_frame(added(corners[1], scaled(corners[0], -1.0)), right, up, back)
        along = unit(*added(edge, scaled(shading, -dot(edge, shading))))
        turned = unit(*scaled(in_world((x, y, z), along, cross(shading, along), shading), side))
        if dot(turned, ahead) < 0:
            normal[at, 0], normal[at, 1], normal[at, 2] = turned[0], turned[1], turned[2]


@compiled
def weights_at(a: Vector, b: Vector, c: Vector, point: Vector) -> tuple[float, float]:
    """Return the barycentric weights of corners b and c at a point of a triangle."""
    along, across, to_point = (
        added(b, scaled(a, -1.0)), added(c, scaled(a, -1.0)), added(point, scaled(a, -1.0)),
    )  # fmt: skip
    aa, ac, cc = dot(along, along), dot(along, across), dot(across, across)
    pa, pc = dot(to_point, along), dot(to_point, across)
    below = max(aa * cc - ac * ac, 1e-300)
    return (cc * pa - ac * pc) / below, (aa * pc - ac * pa) / below


@compiled
def texel_at(
    level: Int[np.ndarray, " m"],
    first: Int[np.ndarray, " m"],
    triangle: int,
    u: float,
    v: float,
    area: float,
    footprint: float,
) -> int:
    """Return the row of the texel at a point; -1 if the triangle's own material is fine enough.

    Args:
        u, v: Weights of corners 1 and 2.
        area: Area of the triangle.
        footprint: Area of what is seen; the texel's is at most that, if the texels are fine enough.
    """
    number, digit, divisions, before = 0, 1, int64(level[triangle]), 0
    for division in range(divisions):
        if area <= footprint:
            divisions = division
            break
        w = 1 - u - v
        place = 3
        if w >= 0.5:
            place, u, v = 0, 2 * u, 2 * v
        elif u >= 0.5:
            place, u, v = 1, 2 * u - 1, 2 * v
        elif v >= 0.5:
            place, u, v = 2, 2 * u, 2 * v - 1
        else:
            u, v = 1 - 2 * w, 1 - 2 * u
        number, before, digit, area = number + digit * place, before + digit, 4 * digit, area / 4
    # a triangle's rows begin with 4 of the first division, 16 of the second, …
    return int64(first[triangle]) + before - 1 + number if divisions > 0 else -1
