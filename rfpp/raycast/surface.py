"""Points on surfaces at which light is gathered."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple, SupportsFloat

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.raycast import ggx
from rfpp.raycast.compiled import compiled, float64
from rfpp.raycast.first_hit import GBuffer
from rfpp.raycast.lit_scene import CLEARANCE
from rfpp.raycast.threads import over_rows
from rfpp.raycast.vectors import Triple, Vector, added, dot, normal_of, scaled, triple
from rfpp.scene.camera import pixel_plane
from rfpp.scene.triangles import DIFFUSE, ROUGHNESS, SPECULAR, SceneTriangles


class Points(NamedTuple):
    """Points of an image for compiled loops.

    Attributes:
        point, normal, diffuse, specular: Arrays of `Surface`.
        eye: Directions to the eye.
        alpha: α of the glossy lobe; negative where it sends nothing to the eye.
        pixel: Pixel of each point.
        nth: Number of the point within its pixel.
        of_pixel: Points per pixel.
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
    """Points of a scene's surfaces.

    Attributes:
        point: Origins of rays, slightly in front of the surface, on the visible side.
        normal: Unit shading normals.
        view: Unit directions to the eye.
        diffuse, specular: Albedos.
        alpha: α of the glossy lobes (`rfpp.raycast.ggx`).
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
        """Describe points on triangles, seen from one eye or from one eye each.

        If the eye is the point itself, its direction is the normal.
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
    def at_hits(
        cls, gbuffer: GBuffer, triangles: SceneTriangles, c2w: Float[np.ndarray, "4 4"], fov: SupportsFloat
    ) -> Surface:
        """Describe the hits of a G-buffer, row by row."""
        pixel = np.flatnonzero(gbuffer.hit)
        point, normal, view, diffuse, specular = np.empty((5, len(pixel), 3))
        alpha = np.empty(len(pixel))
        seen = (gbuffer.triangle.reshape(-1), gbuffer.normal.reshape(-1, 3), gbuffer.depth.reshape(-1))
        height, width = gbuffer.depth.shape
        plane = pixel_plane(height, width, gbuffer.points).reshape(-1, 2)
        slope, pose = np.tan(np.radians(float(fov)) / 2), c2w.astype(np.float64)
        scene, found = (triangles.positions, triangles.material), (point, normal, view, diffuse, specular, alpha)
        over_rows(len(pixel), _seen, *scene, pixel, *seen, plane, slope, pose, *found)
        if (texels := gbuffer.texels) is not None:
            texels.replaced(diffuse, DIFFUSE, pixel)
            texels.replaced(specular, SPECULAR, pixel)
            roughness = texels.replaced(np.sqrt(alpha)[:, None], ROUGHNESS, pixel)[:, 0]
            alpha = np.maximum(roughness**2, ggx.MIN_ALPHA)
        return cls(point, normal, view, diffuse, specular, alpha)

    def __len__(self) -> int:
        return len(self.point)

    def part(self, rows: slice | Int[np.ndarray, " n"]) -> Surface:
        """Return some of the points."""
        return Surface(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def points(self, hit: Bool[np.ndarray, "h w"], along: int = 1) -> Points:
        """Return the points of an image's hits.

        Args:
            hit: True where the image hits a surface.
            along: Points along each side of a pixel.
        """
        place, alpha = np.flatnonzero(hit), np.empty(len(self))
        pixel, nth = np.empty((2, len(self)), np.int64)
        vectors = self.point, self.normal, self.view, self.diffuse, self.specular
        of_rows = place, self.normal, self.view, self.specular, self.alpha, pixel, nth, alpha
        over_rows(len(self), _of_pixels, hit.shape[1], along, *of_rows)
        return Points(*vectors, alpha, pixel, nth, along**2)


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
    for row in range(len(triangle)):
        found = _raised(positions[triangle[row]], triple(position[row]), triple(normal[row]), triple(eye[row]))
        for k in range(3):
            point[row, k], view[row, k] = found[0][k], found[1][k]


@compiled
def _seen(
    start: int,
    stop: int,
    positions: Float[np.ndarray, "m 3 3"],
    material: Float[np.ndarray, "m 10"],
    pixel: Int[np.ndarray, " r"],
    triangle: Int[np.ndarray, " pixels"],
    of_camera: Float[np.ndarray, "pixels 3"],
    depth: Float[np.ndarray, " pixels"],
    plane: Float[np.ndarray, "pixels 2"],
    slope: float,
    pose: Float[np.ndarray, "4 4"],
    point: Float[np.ndarray, "r 3"],
    normal: Float[np.ndarray, "r 3"],
    view: Float[np.ndarray, "r 3"],
    diffuse: Float[np.ndarray, "r 3"],
    specular: Float[np.ndarray, "r 3"],
    alpha: Float[np.ndarray, " r"],
) -> None:
    eye = (pose[0, 3], pose[1, 3], pose[2, 3])
    for row in range(start, stop):
        at = pixel[row]
        own, far = material[triangle[at]], float64(depth[at])
        position = _turned(pose, (far * slope * plane[at, 0], far * slope * plane[at, 1], -far))
        facing = _turned(pose, triple(of_camera[at]))
        found = _raised(positions[triangle[at]], added(position, eye), facing, eye)
        for k in range(3):
            point[row, k], normal[row, k], view[row, k] = found[0][k], facing[k], found[1][k]
            diffuse[row, k], specular[row, k] = own[k], own[3 + k]
        alpha[row] = max(float64(own[6]) * float64(own[6]), ggx.MIN_ALPHA)


@compiled
def _turned(pose: Float[np.ndarray, "4 4"], vector: Vector) -> Triple:
    return dot(pose[0, :3], vector), dot(pose[1, :3], vector), dot(pose[2, :3], vector)


@compiled
def _raised(corners: Float[np.ndarray, "3 3"], position: Vector, normal: Vector, eye: Vector) -> tuple[Triple, Triple]:
    """Return the origin of rays in front of a triangle, and the direction to the eye."""
    away = (eye[0] - position[0], eye[1] - position[1], eye[2] - position[2])
    distance = np.sqrt(dot(away, away))
    view = scaled(away, 1 / distance) if distance > 0 else scaled(normal, 1.0)
    across = normal_of(triple(corners[0]), triple(corners[1]), triple(corners[2]))
    clearance = CLEARANCE / np.sqrt(dot(across, across))
    return added(position, scaled(across, clearance if dot(across, view) >= 0 else -clearance)), view


@compiled
def _of_pixels(
    start: int,
    stop: int,
    width: int,
    along: int,
    place: Int[np.ndarray, " r"],
    normal: Float[np.ndarray, "r 3"],
    view: Float[np.ndarray, "r 3"],
    specular: Float[np.ndarray, "r 3"],
    alpha: Float[np.ndarray, " r"],
    pixel: Int[np.ndarray, " r"],
    nth: Int[np.ndarray, " r"],
    of_lobe: Float[np.ndarray, " r"],
) -> None:
    """Fill in pixel, nth and alpha of `Points`."""
    for row in range(start, stop):
        y, x = place[row] // width, place[row] % width
        pixel[row] = y // along * (width // along) + x // along
        nth[row] = y % along * along + x % along
        shines = max(specular[row, 0], specular[row, 1], specular[row, 2]) > 0 and dot(view[row], normal[row]) > 0
        of_lobe[row] = alpha[row] if shines else -1.0
