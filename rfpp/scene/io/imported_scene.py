"""What every reader gives: parts, lamps and cameras in the file's own units, Z up."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from rfpp.errors import SceneError, one_line
from rfpp.scene.mesh import compacted, triangle_areas
from rfpp.scene.spec import Camera
from rfpp.scene.triangles import EMISSION

#: Reflectance of what the file gives no material, and the specular albedo of plastics, glass and paint.
GREY, DIELECTRIC = 0.6, 0.04
#: No coordinate, intensity or radiance is this large, and squares of smaller ones are still numbers.
BEYOND = 1e30
#: Surfaces whose stored normals lie farther from their face's than this (1 degree) are smooth.
_FLAT_COSINE = math.cos(math.radians(1))
_CHUNK = 1 << 16  # triangles at a time, which bounds the memory


@dataclass(frozen=True, eq=False)
class Part:
    """What becomes an object.

    Attributes:
        name: of the file's; not yet unique.
        vertices: [V, 3] float64.
        faces: [F, 3] int64 vertex indices, counter-clockwise seen from outside.
        material: [F, 10] float32, rows of `SceneTriangles.material`.
        smooth: whether normals are interpolated across edges flatter than 30 degrees.
        see_through: the material that light should pass through, and what says so; none where this is empty.

    Raises:
        SceneError: a face index out of range; a vertex or an emission that is NaN, infinite or absurdly large.
    """

    name: str
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    material: Float[np.ndarray, "f 10"]
    smooth: bool
    see_through: str = ""

    def __post_init__(self) -> None:
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            raise SceneError(f"'{self.name}': a face refers to none of {len(self.vertices)} vertices: export it again")
        for what, values in (("a vertex", self.vertices), ("its emission", self.material)):
            if not (np.abs(values) < BEYOND).all():
                raise SceneError(f"'{self.name}': {what} is NaN or beyond every number: repair or export it again")

    def __len__(self) -> int:
        """The number of faces."""
        return len(self.faces)

    @property
    def corners(self) -> Float[np.ndarray, "f 3 3"]:
        return self.vertices[self.faces]

    @property
    def areas(self) -> Float[np.ndarray, " f"]:
        return triangle_areas(self.vertices, self.faces)

    @property
    def is_light(self) -> bool:
        return bool((self.material[:, EMISSION] > 0).any())

    def only(self, faces: np.ndarray) -> Part:
        """The part of these faces (mask or indices), without vertices that none of them uses."""
        used, renumbered = compacted(self.faces[faces], len(self.vertices))
        return replace(self, vertices=self.vertices[used], faces=renumbered, material=self.material[faces])


@dataclass(frozen=True, eq=False)
class Lamp:
    """A light without extent.

    Attributes:
        name: of the file's.
        kind: a point shines everywhere, a spot about its direction, a directional one from infinitely far.
        strength: [3] radiant intensity (W/sr); of a directional one irradiance (W/m²). Linear RGB.
        position, direction: [3] where it stands and, as a unit vector, where it shines.
    """

    name: str
    kind: Literal["point", "spot", "directional"]
    strength: Float[np.ndarray, 3]
    position: Float[np.ndarray, 3]
    direction: Float[np.ndarray, 3]


@dataclass(frozen=True, eq=False)
class ImportedScene:
    """A file as it was read, or several together."""

    name: str
    parts: tuple[Part, ...]
    lamps: tuple[Lamp, ...] = ()
    cameras: tuple[Camera, ...] = ()

    @classmethod
    def joined(cls, name: str, scenes: Iterable[ImportedScene]) -> ImportedScene:
        scenes = tuple(scenes)
        return cls(
            name,
            sum((scene.parts for scene in scenes), ()),
            sum((scene.lamps for scene in scenes), ()),
            sum((scene.cameras for scene in scenes), ()),
        )


def plain_material(count: int, diffuse: Iterable[float] = (GREY,) * 3) -> Float[np.ndarray, "f 10"]:
    """Rows of a dull dielectric, for formats that know nothing of materials or little."""
    row = np.array([*np.multiply((*diffuse,), 1 - DIELECTRIC), *(DIELECTRIC,) * 3, 0.5, 0, 0, 0], np.float32)
    return np.tile(row, (count, 1))


def is_smooth(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    normals: Float[np.ndarray, "n 3"],
    shaded: Int[np.ndarray, "f 3"],
) -> bool:
    """Whether a stored normal, of which `shaded` has the number at each corner, differs from its face's by a degree."""
    for i in range(0, len(faces), _CHUNK):
        a, b, c = np.moveaxis(vertices[faces[i : i + _CHUNK]], 1, 0)
        stored, of_faces = normals[shaded[i : i + _CHUNK]], np.cross(b - a, c - a)
        lengths = np.linalg.norm(stored, axis=-1) * np.linalg.norm(of_faces, axis=-1)[:, None]
        with np.errstate(over="ignore", invalid="ignore"):
            if (np.abs((stored * of_faces[:, None]).sum(-1)) < _FLAT_COSINE * lengths).any():
                return True
    return False


def name_of(text: str, otherwise: str) -> str:
    """A name of the file's, fit to be shown."""
    return one_line(" ".join(text[:400].split()), 60).strip() or otherwise


def z_up(vectors: np.ndarray) -> np.ndarray:
    """[..., 3] of a world whose Y axis points up, turned about X."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([x, -z, y], axis=-1)


def fans(sizes: Int[np.ndarray, " p"]) -> tuple[Int[np.ndarray, "t 3"], Int[np.ndarray, " t"]]:
    """Polygons of so many corners, stored one after the other, cut into triangles.

    Returns:
        the triangles' corners as positions in the storage, and the polygon of each triangle.
    """
    count = np.maximum(sizes - 2, 0)
    polygon = np.repeat(np.arange(len(sizes)), count)
    first = (np.cumsum(sizes) - sizes)[polygon]
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(count) - count, count)
    return np.stack([first, first + step + 1, first + step + 2], axis=1), polygon
