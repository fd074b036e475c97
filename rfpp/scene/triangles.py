"""SceneTriangles: the packed world-space triangles of one scene, which network, G-buffer and Cycles all read."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, has_area, normalized, without_degenerate_faces
from rfpp.scene.shading_normals import corner_normals, shading_groups
from rfpp.scene.spec import Material, Scene, SceneObject, Vector

#: Columns of `SceneTriangles.material`.
DIFFUSE, SPECULAR, ROUGHNESS, EMISSION = slice(0, 3), slice(3, 6), slice(6, 7), slice(7, 10)


@dataclass(frozen=True)
class SceneTriangles:
    """World-space triangles of a scene, sorted by object.

    Attributes:
        positions: [M, 3, 3] float32, (triangle, corner, xyz).
        normals: [M, 3, 3] float32 unit shading normals per corner.
        material: [M, 10] float32: diffuse 3, specular 3, roughness 1, emitted radiance 3 (linear).
        object_offsets: [O + 1] int32, CSR style: object o owns triangles offsets[o]:offsets[o + 1].
        object_names: O names, in order.
    """

    positions: np.ndarray
    normals: np.ndarray
    material: np.ndarray
    object_offsets: np.ndarray
    object_names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def num_objects(self) -> int:
        return len(self.object_offsets) - 1

    @property
    def is_emissive(self) -> np.ndarray:
        """[M] bool. Emissive triangles light the scene and are invisible to the camera."""
        return (self.material[:, EMISSION] > 0).any(axis=1)

    @property
    def object_index(self) -> np.ndarray:
        """[M] int32: the object each triangle belongs to."""
        return np.repeat(np.arange(self.num_objects, dtype=np.int32), np.diff(self.object_offsets))

    @property
    def light_names(self) -> tuple[str, ...]:
        """Of the objects that emit light, in order."""
        return tuple(self.object_names[number] for number in np.unique(self.object_index[self.is_emissive]))

    @property
    def num_lights(self) -> int:
        """How many objects emit light."""
        return len(self.light_names)

    @classmethod
    def from_scene(cls, scene: Scene) -> SceneTriangles:
        """Pack a scene: transforms applied, shading normals made, random colours drawn, zero-area triangles dropped.

        Raises:
            SceneError: naming the object, if nothing of it is left.
        """
        placed, meshes = zip(*world_meshes(scene), strict=True)
        return cls(
            positions=np.concatenate([mesh.corners for mesh in meshes]),
            normals=np.concatenate(
                [
                    corner_normals(mesh, item.material.smooth_shading)
                    for item, mesh in zip(scene.objects, meshes, strict=True)
                ]
            ),
            material=np.concatenate(
                [
                    _material_rows(item.material, mesh)
                    if item.face_material is None
                    else item.face_material[has_area(before)].astype(np.float32)
                    for item, before, mesh in zip(scene.objects, placed, meshes, strict=True)
                ]
            ),
            object_offsets=np.cumsum([0, *map(len, meshes)], dtype=np.int32),
            object_names=tuple(item.name for item in scene.objects),
        )


def rotation_matrix(degrees: Vector) -> Float[np.ndarray, "3 3"]:
    """Rotation about the world x, then y, then z axis, float64."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def world_meshes(scene: Scene) -> list[tuple[Mesh, Mesh]]:
    """Each object's mesh where it stands, whole and without triangles of zero area.

    Raises:
        SceneError: naming the object, if nothing of it is left or it is not finite.
    """
    meshes = []
    for item in scene.objects:
        try:
            placed = _placed(item)
            meshes.append((placed, without_degenerate_faces(placed)))
        except SceneError as error:
            raise SceneError(f"object '{item.name}': {error}") from None
    return meshes


def _placed(item: SceneObject) -> Mesh:
    """The mesh after its transform, still facing outwards if it was mirrored.

    Shading normals are made from this mesh, as RenderFormer does, so no normal ever needs the inverse transpose.
    """
    transform = item.transform
    mesh = normalized(item.mesh) if transform.normalize else item.mesh
    rotated = mesh.vertices @ rotation_matrix(transform.rotation).T
    vertices = rotated * np.array(transform.scale) + np.array(transform.translation)
    faces = mesh.faces[:, ::-1] if np.prod(np.sign(transform.scale)) < 0 else mesh.faces
    return Mesh(vertices, faces)


def _material_rows(material: Material, mesh: Mesh) -> np.ndarray:
    """[F, 10] float32."""
    row = np.array([*material.diffuse, *material.specular, material.roughness, *material.emissive], dtype=np.float32)
    rows = np.tile(row, (len(mesh), 1))
    if material.rand_tri_diffuse_seed is not None:
        rows[:, DIFFUSE] = _random_diffuse(material, mesh)
    return rows


def _random_diffuse(material: Material, mesh: Mesh) -> np.ndarray:
    """[F, 3]: one 8-bit colour per triangle or per smoothly shaded part."""
    by_part = material.smooth_shading and material.random_diffuse_type == "per-shading-group"
    groups = shading_groups(mesh, smooth=by_part)
    # The legacy generator because RenderFormer's converter draws from it: the same seed gives the same colours.
    rng = np.random.RandomState(material.rand_tri_diffuse_seed)
    below = max(1, math.ceil(256 * material.random_diffuse_max))
    return rng.randint(0, below, size=(groups.max() + 1, 3))[groups] / 255
