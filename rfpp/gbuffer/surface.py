"""Points on surfaces that light is gathered at."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float, Int

from rfpp.gbuffer import ggx
from rfpp.gbuffer.first_hit import GBuffer, camera_positions
from rfpp.scene.triangles import DIFFUSE, ROUGHNESS, SPECULAR, SceneTriangles

#: Rays start and end this far from surfaces, in world units (a scene's edge is 1).
CLEARANCE = 1e-4
#: Pairs of a point and a sample worked on at a time, which bounds the memory.
_CHUNK = 1 << 18


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
        view = eye - position
        distance = np.linalg.norm(view, axis=-1, keepdims=True)
        view = np.where(distance > 0, view / np.where(distance > 0, distance, 1), normal)
        corners = triangles.positions[triangle].astype(np.float64)
        geometric = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        geometric /= np.linalg.norm(geometric, axis=-1, keepdims=True)
        geometric *= np.where((geometric * view).sum(-1, keepdims=True) < 0, -1.0, 1.0)
        material = triangles.material[triangle].astype(np.float64)
        return cls(
            point=position + CLEARANCE * geometric,
            normal=normal.astype(np.float64),
            view=view.astype(np.float64),
            diffuse=material[:, DIFFUSE],
            specular=material[:, SPECULAR],
            alpha=np.maximum(material[:, ROUGHNESS][:, 0] ** 2, ggx.MIN_ALPHA),
        )

    @classmethod
    def seen(
        cls, gbuffer: GBuffer, triangles: SceneTriangles, c2w: Float[np.ndarray, "4 4"], fov: SupportsFloat
    ) -> Surface:
        """The pixels of a G-buffer that hit something, row by row."""
        turn = c2w[:3, :3].astype(np.float64)
        position = camera_positions(gbuffer.depth, fov)[gbuffer.hit] @ turn.T + c2w[:3, 3]
        normal = gbuffer.normal[gbuffer.hit] @ turn.T
        return cls.at(triangles, gbuffer.triangle[gbuffer.hit], position, normal, c2w[:3, 3])

    def __len__(self) -> int:
        return len(self.point)

    def part(self, rows: slice | Int[np.ndarray, " n"]) -> Surface:
        """Some of the points."""
        return Surface(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def frame(self) -> Float[np.ndarray, "r 3 3"]:
        """Rows: two tangents and the normal (Duff et al., "Building an Orthonormal Basis, Revisited", 2017)."""
        x, y, z = self.normal.T
        sign = np.where(z < 0, -1.0, 1.0)
        a = -1 / (sign + z)
        b = x * y * a
        first = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
        second = np.stack([b, sign + y * y * a, -y], axis=-1)
        return np.stack([first, second, self.normal], axis=1)


def local(vectors: Float[np.ndarray, "r *s 3"], frame: Float[np.ndarray, "r 3 3"]) -> Float[np.ndarray, "r *s 3"]:
    """World vectors in the frame of each point."""
    return np.einsum("r...x,rkx->r...k", vectors, frame)


def cosine_directions(surface: Surface, random: Float[np.ndarray, "r 2"]) -> Float[np.ndarray, "r 3"]:
    """World directions as dense as diffuse light arrives from them: points of a disc, lifted (Malley 1988)."""
    radius, angle = np.sqrt(random[:, 0]), 2 * np.pi * random[:, 1]
    local = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - random[:, 0])], axis=-1)
    return np.einsum("rk,rkx->rx", local, surface.frame())


def lattice(samples: int, shift: Float[np.ndarray, "r 2"]) -> Float[np.ndarray, "r s 2"]:
    """Well-spread points of the unit square, displaced per row (Cranley and Patterson 1976)."""
    count = np.arange(samples)
    spread = np.stack([(count + 0.5) / samples, count * 0.6180339887498949 % 1], axis=-1)
    return (spread + shift[:, None]) % 1


def chunks(count: int, width: int) -> Iterator[slice]:
    """Rows to work on together, where each has `width` numbers."""
    step = max(1, _CHUNK // width)
    return (slice(start, start + step) for start in range(0, count, step))
