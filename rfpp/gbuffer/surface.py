"""Points on surfaces that light is gathered at."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple, SupportsFloat

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.gbuffer import ggx
from rfpp.gbuffer.compiled import compiled
from rfpp.gbuffer.first_hit import GBuffer, camera_positions
from rfpp.gbuffer.lit_scene import CLEARANCE
from rfpp.gbuffer.vectors import GOLDEN, normal_of, tangents, triple
from rfpp.scene.camera import rotated
from rfpp.scene.triangles import DIFFUSE, ROUGHNESS, SPECULAR, SceneTriangles


class Points(NamedTuple):
    """What loops read of R points that lie in pixels.

    Attributes:
        point, normal, diffuse, specular: as `Surface` has them.
        eye: direction that each is seen from.
        alpha: negative where the glossy lobe sends nothing to the eye.
        pixel: [R] that each lies in.
        nth: [R] which of the pixel's points it is.
        of_pixel: how many points a pixel has.
    """

    point: Float[np.ndarray, "r 3"]
    normal: Float[np.ndarray, "r 3"]
    eye: Float[np.ndarray, "r 3"]
    diffuse: Float[np.ndarray, "r 3"]
    specular: Float[np.ndarray, "r 3"]
    alpha: Float[np.ndarray, " r"]
    pixel: Int[np.ndarray, " r"]
    nth: Int[np.ndarray, " r"]
    of_pixel: int


@dataclass(frozen=True, eq=False)
class Surface:
    """R points of a scene's surfaces: where rays start, shading normal, direction they are seen from, material.

    Attributes:
        point: a little in front of the surface, on the side that is seen.
        normal, view: unit vectors.
        diffuse, specular: albedos.
        alpha: of the glossy lobe (`rfpp.gbuffer.ggx`).
    """

    point: Float[np.ndarray, "r 3"]
    normal: Float[np.ndarray, "r 3"]
    view: Float[np.ndarray, "r 3"]
    diffuse: Float[np.ndarray, "r 3"]
    specular: Float[np.ndarray, "r 3"]
    alpha: Float[np.ndarray, " r"]

    @classmethod
    def at(
        cls,
        triangles: SceneTriangles,
        triangle: Int[np.ndarray, " r"],
        position: Float[np.ndarray, "r 3"],
        normal: Float[np.ndarray, "r 3"],
        eye: Float[np.ndarray, "*r 3"],
    ) -> Surface:
        """Points on triangles with their shading normals, seen from `eye`, one for all or one for each.

        An eye that lies in the point itself looks along the normal.
        """
        position, normal = (np.ascontiguousarray(x, np.float64) for x in (position, normal))
        eye = np.broadcast_to(np.asarray(eye, np.float64), position.shape)
        point, view, material = np.empty_like(position), np.empty_like(position), triangles.material[triangle]
        _in_front(triangles.positions, triangle, position, normal, eye, point, view)
        return cls(
            point=point,
            normal=normal,
            view=view,
            diffuse=material[:, DIFFUSE].astype(np.float64),
            specular=material[:, SPECULAR].astype(np.float64),
            alpha=np.maximum(material[:, ROUGHNESS][:, 0].astype(np.float64) ** 2, ggx.MIN_ALPHA),
        )

    @classmethod
    def seen(
        cls, gbuffer: GBuffer, triangles: SceneTriangles, c2w: Float[np.ndarray, "4 4"], fov: SupportsFloat
    ) -> Surface:
        """The pixels of a G-buffer that hit something, row by row."""
        turn = c2w[:3, :3].astype(np.float64)
        position = rotated(camera_positions(gbuffer.depth, fov, gbuffer.points)[gbuffer.hit], turn) + c2w[:3, 3]
        normal = rotated(gbuffer.normal[gbuffer.hit], turn)
        return cls.at(triangles, gbuffer.triangle[gbuffer.hit], position, normal, c2w[:3, 3])

    def __len__(self) -> int:
        return len(self.point)

    def part(self, rows: slice | Int[np.ndarray, " n"]) -> Surface:
        """Some of the points."""
        return Surface(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def points(self, hit: Bool[np.ndarray, "h w"], along: int = 1) -> Points:
        """These points, one for each pixel of an image that hits something or, with so many points along each side of a
        pixel, for each point."""
        rows, columns = np.nonzero(hit)
        pixel = rows // along * (hit.shape[1] // along) + columns // along
        nth = rows % along * along + columns % along
        shines = (self.specular > 0).any(-1) & ((self.view * self.normal).sum(-1) > 0)
        alpha = np.where(shines, self.alpha, -1.0)
        return Points(self.point, self.normal, self.view, self.diffuse, self.specular, alpha, pixel, nth, along**2)

    def frame(self) -> Float[np.ndarray, "r 3 3"]:
        """Rows: two tangents and the normal."""
        frames = np.empty((len(self), 3, 3))
        _frames(self.normal, frames)
        return frames


@compiled
def _frames(normals: Float[np.ndarray, "r 3"], frames: Float[np.ndarray, "r 3 3"]) -> None:
    for row in range(len(normals)):
        first, second = tangents(normals[row])
        for k in range(3):
            frames[row, 0, k], frames[row, 1, k], frames[row, 2, k] = first[k], second[k], normals[row, k]


@compiled
def _in_front(
    positions: Float[np.ndarray, "m 3 3"],
    triangle: Int[np.ndarray, " r"],
    position: Float[np.ndarray, "r 3"],
    normal: Float[np.ndarray, "r 3"],
    eye: Float[np.ndarray, "r 3"],
    point: Float[np.ndarray, "r 3"],
    view: Float[np.ndarray, "r 3"],
) -> None:
    """Fills in where rays start, and the unit direction to the eye."""
    for row in range(len(triangle)):
        here = position[row]
        wx, wy, wz = eye[row, 0] - here[0], eye[row, 1] - here[1], eye[row, 2] - here[2]
        distance = np.sqrt(wx * wx + wy * wy + wz * wz)
        if distance > 0:
            wx, wy, wz = wx / distance, wy / distance, wz / distance
        else:
            wx, wy, wz = normal[row]
        view[row, 0], view[row, 1], view[row, 2] = wx, wy, wz
        corners = positions[triangle[row]]
        a, b, c = triple(corners[0]), triple(corners[1]), triple(corners[2])
        x, y, z = normal_of(a, b, c)
        clearance = CLEARANCE / np.sqrt(x * x + y * y + z * z)
        if x * wx + y * wy + z * wz < 0:
            clearance = -clearance
        point[row, 0] = here[0] + clearance * x
        point[row, 1] = here[1] + clearance * y
        point[row, 2] = here[2] + clearance * z


def cosine_directions(surface: Surface, random: Float[np.ndarray, "r 2"]) -> Float[np.ndarray, "r 3"]:
    """World directions as dense as diffuse light arrives from them: points of a disc, lifted (Malley 1988)."""
    radius, angle = np.sqrt(random[:, 0]), 2 * np.pi * random[:, 1]
    local = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - random[:, 0])], axis=-1)
    directions: np.ndarray = np.einsum("rk,rkx->rx", local, surface.frame())
    return directions


def lattice(samples: int, shift: Float[np.ndarray, "r 2"]) -> Float[np.ndarray, "r s 2"]:
    """Well-spread points of the unit square, displaced per row (Cranley and Patterson 1976)."""
    count = np.arange(samples)
    spread = np.stack([(count + 0.5) / samples, count * GOLDEN % 1], axis=-1)
    displaced: np.ndarray = spread + shift[:, None]
    return displaced % 1
