"""What a scene is: objects with one mesh and one material each, and cameras.

Scenes live inside [-0.5, 0.5]^3 (lights may stand outside), right-handed, Z up. A `Scene` is immutable and
valid by construction: whoever holds one need not check it again.
"""

from __future__ import annotations

import math
import reprlib
import warnings
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from rfpp.errors import SceneError, one_line
from rfpp.scene.mesh import Mesh

#: Lengths, angles and radiances beyond are mistakes, and lose what is small beside them in float32.
FARTHEST, BRIGHTEST = 1e5, 1e9
Number = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
Vector = tuple[Number, Number, Number]
Reflectance = tuple[
    Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=0, le=1)]
]
Power = Annotated[float, Field(ge=0, le=BRIGHTEST)]
Radiance = tuple[Power, Power, Power]


class Strict(BaseModel):
    """Immutable, finite numbers only, unknown keys refused; a bad value raises a one-line SceneError."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True)
    #: What the error messages call an instance.
    noun: ClassVar[str] = ""

    def __init__(self, **values: object) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise SceneError(first_problem(error, self.noun)) from None


class Material(Strict):
    """Diffuse plus GGX-specular reflectance and emitted radiance (RenderFormer JSON v1.0 names).

    Attributes:
        diffuse: diffuse albedo, linear RGB in [0, 1].
        specular: albedo of the specular lobe at all angles (no Fresnel term), linear RGB in [0, 1].
        roughness: perceptual roughness in [0, 1]; the GGX alpha is its square.
        emissive: emitted radiance, linear RGB, of both sides of each triangle.
        smooth_shading: interpolate normals across edges flatter than 30 degrees.
        rand_tri_diffuse_seed: if set, diffuse is replaced by random colours drawn with this seed.
        random_diffuse_max: upper bound of those colours.
        random_diffuse_type: one colour per triangle or per smoothly shaded part.
    """

    noun = "material"

    diffuse: Reflectance
    specular: Reflectance
    roughness: Annotated[float, Field(ge=0, le=1)]
    emissive: Radiance = (0.0, 0.0, 0.0)
    smooth_shading: bool = False
    rand_tri_diffuse_seed: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    random_diffuse_max: Annotated[float, Field(ge=0, le=1)] = 0.4
    random_diffuse_type: Literal["per-triangle", "per-shading-group"] = "per-shading-group"

    @property
    def is_emissive(self) -> bool:
        return any(e > 0 for e in self.emissive)


class Transform(Strict):
    """Mesh to world: optional normalisation, rotation about world x, y, z in turn, scale, translation.

    Attributes:
        translation: world units.
        rotation: degrees about the world x, y and z axes, applied in that order.
        scale: per world axis, after the rotation.
        normalize: first subtract the vertex mean and divide so that the farthest vertex is at radius 0.5.
    """

    noun = "transform"

    translation: Vector = (0.0, 0.0, 0.0)
    rotation: Vector = (0.0, 0.0, 0.0)
    scale: Vector = (1.0, 1.0, 1.0)
    normalize: bool = True


class Camera(Strict):
    """A pinhole camera; `fov` is the full angle in degrees along the longer image side."""

    noun = "camera"

    position: Vector
    look_at: Vector
    up: Vector = (0.0, 0.0, 1.0)
    fov: Annotated[float, Field(gt=0, lt=180)]

    @model_validator(mode="after")
    def _has_a_direction(self) -> Camera:
        forward = np.subtract(self.look_at, self.position)
        if np.linalg.norm(forward) < 1e-8:
            raise ValueError("look_at equals position, so the camera looks nowhere: move one of them")
        if np.linalg.norm(np.cross(forward, self.up)) < 1e-8 * np.linalg.norm(forward):
            raise ValueError("up is zero or parallel to the viewing direction: choose another up vector")
        return self


class SceneObject(Strict):
    """One mesh, where it stands and what it is made of.

    Attributes:
        name: unique in its scene.
        mesh: in the mesh's own coordinates, before `transform`.
        transform, material: see there.
        face_material: [F, 10] float32, if the material varies over the faces: rows of `SceneTriangles.material`, which
            then hold instead of `material`. That keeps the area-weighted mean, and the shading.
    """

    noun = "object"

    name: Annotated[str, Field(min_length=1)]
    mesh: Mesh
    material: Material
    transform: Transform = Transform()
    face_material: np.ndarray | None = None

    @model_validator(mode="after")
    def _has_a_material_for_each_face(self) -> SceneObject:
        rows = self.face_material
        if rows is None:
            return self
        if rows.shape != (len(self.mesh), 10):
            raise ValueError(f"face_material: shape {rows.shape}, not ({len(self.mesh)}, 10): give a row for each face")
        if not (np.isfinite(rows).all() and rows.min() >= 0 and rows[:, :7].max() <= 1):
            raise ValueError("face_material: a reflectance or roughness outside [0, 1], or a bad emission: correct it")
        return self

    @model_validator(mode="after")
    def _conserves_energy(self) -> SceneObject:
        material = self.material
        total = max(d + s for d, s in zip(material.diffuse, material.specular, strict=True))
        if total > 1 + 1e-6 and not math.isclose(total, 1, rel_tol=1e-4):
            warnings.warn(
                f"object '{self.name}': diffuse + specular is {total:.3g}, above 1: it reflects more than it receives",
                stacklevel=2,
            )
        return self


class Scene(Strict):
    """Objects and cameras. Raises SceneError when empty or when object names repeat."""

    noun = "scene"

    name: str = "scene"
    objects: tuple[SceneObject, ...]
    cameras: tuple[Camera, ...] = ()

    @model_validator(mode="after")
    def _is_not_empty(self) -> Scene:
        if not self.objects:
            raise ValueError("objects: the scene is empty: add at least one object")
        names = [o.name for o in self.objects]
        if len(set(names)) != len(names):
            raise ValueError(f"objects: the name '{next(n for n in names if names.count(n) > 1)}' is used twice")
        return self


def first_problem(error: ValidationError, noun: str = "") -> str:
    """The first validation problem as `noun.key.path: what is wrong`, without pydantic's decoration."""
    problem = error.errors(include_url=False)[0]
    where = one_line(".".join(filter(None, [noun, *map(str, problem["loc"])])))
    match problem["type"]:
        case "extra_forbidden":
            what = "unknown key: remove it or correct its spelling"
        case "missing":
            what = "this key is missing: add it"
        case "value_error":
            what = str(problem["ctx"]["error"])
        case _:
            what = f"{problem['msg'][0].lower()}{problem['msg'][1:]}, not {reprlib.repr(problem['input'])}"
    return f"{where}: {what}" if where else what
