"""Output of the readers of other programs' files: parts, lights and cameras in the file's units, Z up."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from rfpp.errors import SceneError, one_line
from rfpp.scene.mesh import compacted, triangle_areas
from rfpp.scene.spec import Camera
from rfpp.scene.texels import Texels
from rfpp.scene.triangles import EMISSION

#: Reflectance of surfaces without material, and the specular albedo of plastics, glass and paint.
GREY, DIELECTRIC = 0.6, 0.04
#: Limit of coordinates, intensities and radiances; squares of smaller values stay finite.
BEYOND = 1e30
#: Surfaces whose stored normals differ by more than 1 degree from the face normal are smooth.
_FLAT_COSINE = math.cos(math.radians(1))
_CHUNK = 1 << 16  # triangles at a time, which bounds the memory


@dataclass(frozen=True, eq=False)
class Part:
    """Surface that becomes an object.

    Attributes:
        name: name from the file; not yet unique.
        vertices: [V, 3] float64.
        faces: [F, 3] int64 vertex indices, counter-clockwise seen from outside.
        material: [F, 10] float32, rows of `SceneTriangles.material`.
        smooth: interpolate normals across edges flatter than 30 degrees.
        see_through: name of the transparent material and the reason; empty if the part is opaque.
        one_sided: emitted light leaves the front only.
        texels: materials that vary within the faces.

    Raises:
        SceneError: If a face index is out of range, or a vertex or a material is NaN, infinite or too large.
    """

    name: str
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    material: Float[np.ndarray, "f 10"]
    smooth: bool
    see_through: str = ""
    one_sided: bool = False
    texels: Texels | None = None

    def __post_init__(self) -> None:
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            raise SceneError(f"'{self.name}': a face refers to none of {len(self.vertices)} vertices: export it again")
        for what, values in (("a vertex", self.vertices), ("its material", self.material)):
            if values.size and not -BEYOND < values.min() <= values.max() < BEYOND:
                raise SceneError(f"'{self.name}': {what} is NaN, infinite or too large: repair or export it again")

    def __len__(self) -> int:
        """Return the number of faces."""
        return len(self.faces)

    @property
    def corners(self) -> Float[np.ndarray, "f 3 3"]:
        return self.vertices[self.faces]

    @property
    def areas(self) -> Float[np.ndarray, " f"]:
        return triangle_areas(self.vertices, self.faces)

    @cached_property
    def is_light(self) -> bool:
        return bool((self.material[:, EMISSION] > 0).any())

    def only(self, faces: np.ndarray) -> Part:
        """Return the part with some faces (mask or indices), without unused vertices."""
        used, renumbered = compacted(self.faces[faces], len(self.vertices))
        texels = None if self.texels is None else self.texels.only(faces)
        return replace(
            self, vertices=self.vertices[used], faces=renumbered, material=self.material[faces], texels=texels
        )


@dataclass(frozen=True, eq=False)
class PunctualLight:
    """A light without extent.

    Attributes:
        kind: shines in all directions, in a cone, or from infinity.
        strength: [3] linear RGB radiant intensity (W/sr); irradiance (W/m²) for directional lights.
        position, direction: [3] location, and unit direction of the light.
        cone: half angles in radians of a spot's full intensity and of its edge.
    """

    name: str
    kind: Literal["point", "spot", "directional"]
    strength: Float[np.ndarray, 3]
    position: Float[np.ndarray, 3]
    direction: Float[np.ndarray, 3]
    cone: tuple[float, float] = (0.0, math.pi / 4)


@dataclass(frozen=True, eq=False)
class ImportedScene:
    """The content of a file, or of several files."""

    name: str
    parts: tuple[Part, ...]
    punctual_lights: tuple[PunctualLight, ...] = ()
    cameras: tuple[Camera, ...] = ()

    @classmethod
    def joined(cls, name: str, scenes: Iterable[ImportedScene]) -> ImportedScene:
        scenes = tuple(scenes)
        parts, punctual_lights, cameras = (
            sum((getattr(scene, field) for scene in scenes), ()) for field in ("parts", "punctual_lights", "cameras")
        )
        return cls(name, parts, punctual_lights, cameras)


def plain_material(count: int, diffuse: Iterable[float] = (GREY,) * 3) -> Float[np.ndarray, "f 10"]:
    """Return rows of a matte dielectric, for formats with little or no material information."""
    row = np.array([*np.multiply((*diffuse,), 1 - DIELECTRIC), *(DIELECTRIC,) * 3, 0.5, 0, 0, 0], np.float32)
    return np.tile(row, (count, 1))


def is_smooth(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    normals: Float[np.ndarray, "n 3"],
    shaded: Int[np.ndarray, "f 3"],
) -> bool:
    """Return True if a stored normal (at `shaded`, its index at each corner) is a degree off its face's normal."""
    for i in range(0, len(faces), _CHUNK):
        a, b, c = np.moveaxis(vertices[faces[i : i + _CHUNK]], 1, 0)
        stored, face_normals = normals[shaded[i : i + _CHUNK]], np.cross(b - a, c - a)
        lengths = np.linalg.norm(stored, axis=-1) * np.linalg.norm(face_normals, axis=-1)[:, None]
        with np.errstate(over="ignore", invalid="ignore"):
            if (np.abs((stored * face_normals[:, None]).sum(-1)) < _FLAT_COSINE * lengths).any():
                return True
    return False


def name_of(text: str, default: str) -> str:
    """Return a name from the file, fit for display."""
    return one_line(" ".join(text[:400].split()), 60).strip() or default


def z_up(vectors: np.ndarray) -> np.ndarray:
    """Rotate [..., 3] vectors of a Y-up world about X to Z up."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([x, -z, y], axis=-1)
