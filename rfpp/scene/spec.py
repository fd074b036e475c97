"""Scenes: objects with one mesh and one material each, and cameras.

Scenes lie inside [-0.5, 0.5]^3 (lights may be outside), right-handed, Z up. A `Scene` is immutable and valid by
construction.
"""

from __future__ import annotations

import math
import reprlib
import warnings
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from rfpp.errors import SceneError, one_line
from rfpp.scene.mesh import Mesh, has_area, normalized, without_degenerate_faces
from rfpp.scene.texels import Texels

#: Larger lengths, angles and radiances are mistakes, and lose small values beside them in float32.
FARTHEST, BRIGHTEST = 1e5, 1e9
Number = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
Vector = tuple[Number, Number, Number]
Reflectance = tuple[
    Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=0, le=1)]
]
Power = Annotated[float, Field(ge=0, le=BRIGHTEST)]
Radiance = tuple[Power, Power, Power]


class Strict(BaseModel):
    """Immutable base class with finite numbers and known keys only; a bad value raises a one-line SceneError."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True)
    #: Name of an instance in error messages.
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
        emissive: emitted radiance, linear RGB, of both sides of each triangle, or of the front only if `one_sided`.
        smooth_shading: interpolate normals across edges flatter than 30 degrees.
        rand_tri_diffuse_seed: if set, random colors drawn with this seed replace diffuse.
        random_diffuse_max: upper bound of those colors.
        random_diffuse_type: one color per triangle or per smoothly shaded part.
    """

    noun = "material"

    diffuse: Reflectance
    specular: Reflectance
    roughness: Annotated[float, Field(ge=0, le=1)]
    emissive: Radiance = (0.0, 0.0, 0.0)
    one_sided: bool = False
    smooth_shading: bool = False
    rand_tri_diffuse_seed: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    random_diffuse_max: Annotated[float, Field(ge=0, le=1)] = 0.4
    random_diffuse_type: Literal["per-triangle", "per-shading-group"] = "per-shading-group"

    @property
    def is_emissive(self) -> bool:
        return any(e > 0 for e in self.emissive)


class Transform(Strict):
    """Mesh to world: optional normalization, rotation about world x, y, z in turn, scale, translation.

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
    normalize: bool = False

    def apply(self, mesh: Mesh) -> Mesh:
        """Return the mesh in world space, still facing outwards if it is mirrored.

        Shading normals are computed from this mesh, as in RenderFormer, so normals never need the inverse transpose.
        """
        mesh = normalized(mesh) if self.normalize else mesh
        rotated = mesh.vertices @ rotation_matrix(self.rotation).T
        vertices = rotated * np.array(self.scale) + np.array(self.translation)
        return Mesh(vertices, mesh.faces[:, ::-1] if np.prod(np.sign(self.scale)) < 0 else mesh.faces)


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
    """A mesh with a transform and a material.

    Attributes:
        mesh: triangles in the object's own coordinates, before `transform`.
        face_material: [F, 10] float32 rows of `SceneTriangles.material`, if the material varies over the faces; they
            replace `material`, which then holds their area-weighted mean, and the shading.
        texels: Materials that vary within faces; without `face_material`, or if `transform` mirrors, they are not used.
    """

    noun = "object"

    name: Annotated[str, Field(min_length=1)]
    mesh: Mesh
    material: Material
    transform: Transform = Transform()
    face_material: np.ndarray | None = None
    texels: Texels | None = None

    @cached_property
    def world_mesh(self) -> Mesh:
        """The transformed mesh without zero-area triangles, computed once. Raises SceneError if nothing is left."""
        try:
            return without_degenerate_faces(self.transform.apply(self.mesh))
        except SceneError as error:
            raise SceneError(f"object '{self.name}': {error}") from None

    @cached_property
    def world_face_material(self) -> np.ndarray | None:
        """`face_material` of the faces of `world_mesh`, computed once."""
        if self.face_material is None:
            return None
        return self.face_material[has_area(self.transform.apply(self.mesh))].astype(np.float32)

    @cached_property
    def world_texels(self) -> Texels | None:
        """`texels` of the faces of `world_mesh`, computed once."""
        if self.texels is None or self.face_material is None or np.prod(np.sign(self.transform.scale)) < 0:
            return None
        solid = has_area(self.transform.apply(self.mesh))
        return self.texels if solid.all() else self.texels.only(solid)

    def __iter__(self) -> Iterator[tuple[str, Any]]:
        """Yield fields only, so that `dict(item)` is valid input; pydantic would include cached properties."""
        return ((name, getattr(self, name)) for name in type(self).model_fields)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> SceneObject:
        """Copy the object with changes, without its cached properties, which pydantic copies."""
        copied = super().model_copy(update=update, deep=deep)
        for name in ("world_mesh", "world_face_material", "world_texels"):
            copied.__dict__.pop(name, None)
        return copied

    @model_validator(mode="after")
    def _has_a_material_for_each_face(self) -> SceneObject:
        rows = self.face_material
        if self.texels is not None and len(self.texels) != len(self.mesh):
            raise ValueError(f"texels: of {len(self.texels)} faces, not {len(self.mesh)}: give texels for each face")
        if rows is None:
            return self
        if rows.shape != (len(self.mesh), 10):
            raise ValueError(f"face_material: shape {rows.shape}, not ({len(self.mesh)}, 10): give one row per face")
        if not (np.isfinite(rows).all() and rows.min() >= 0 and rows[:, :7].max() <= 1):
            raise ValueError("face_material: reflectance or roughness outside [0, 1], or invalid emission: correct it")
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
    """Objects and cameras. Raises SceneError if it is empty or object names repeat."""

    noun = "scene"

    name: str = "scene"
    objects: tuple[SceneObject, ...]
    cameras: tuple[Camera, ...] = ()

    def __repr__(self) -> str:
        faces = sum(len(item.mesh) for item in self.objects)
        return f"<Scene '{self.name}': {len(self.objects)} objects, {faces} triangles, {len(self.cameras)} cameras>"

    __str__ = __repr__

    @model_validator(mode="after")
    def _is_not_empty(self) -> Scene:
        if not self.objects:
            raise ValueError("objects: the scene is empty: add at least one object")
        names = [o.name for o in self.objects]
        if len(set(names)) != len(names):
            raise ValueError(f"objects: the name '{next(n for n in names if names.count(n) > 1)}' is used twice")
        return self


def rotation_matrix(degrees: Vector) -> Float[np.ndarray, "3 3"]:
    """Return the rotation about the world x, then y, then z axis, float64."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def first_problem(error: ValidationError, noun: str = "") -> str:
    """Return the first validation problem as `noun.key.path: problem`."""
    problem = error.errors(include_url=False)[0]
    where = one_line(".".join(filter(None, [noun, *map(str, problem["loc"])])))
    match problem["type"]:
        case "extra_forbidden":
            what = "unknown key: remove it or correct its spelling"
        case "missing":
            what = "this key is missing: add it"
        case "value_error":
            what = str(problem["ctx"]["error"])
        case "too_long":
            what = f"{len(problem['input']):,} are more than {problem['ctx']['max_length']:,}"
        case _:
            given = one_line(reprlib.repr(problem["input"]))
            what = f"{problem['msg'][0].lower()}{problem['msg'][1:]}, not {given}"
    return f"{where}: {what}" if where else what
