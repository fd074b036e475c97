"""SceneTriangles: the packed world-space triangles of a scene, the input of networks, ray casting and Cycles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rfpp.scene.mesh import Mesh
from rfpp.scene.shading_normals import corner_normals, shading_groups
from rfpp.scene.spec import Material, Scene, SceneObject
from rfpp.scene.texels import Texels

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
        one_sided: Names of the emitters that shine only on the side from which their corners run counterclockwise.
        texels: Materials that vary within triangles, for what cameras see.
    """

    positions: np.ndarray
    normals: np.ndarray
    material: np.ndarray
    object_offsets: np.ndarray
    object_names: tuple[str, ...]
    one_sided: frozenset[str] = frozenset()
    texels: Texels | None = None

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def num_objects(self) -> int:
        return len(self.object_offsets) - 1

    @property
    def is_emissive(self) -> np.ndarray:
        """[M] bool. Emissive triangles light the scene and are invisible to the camera."""
        red, green, blue = (self.material[:, EMISSION] > 0).T
        return red | green | blue  # several times as fast as `any` along rows of three

    @property
    def is_one_sided(self) -> np.ndarray:
        """[M] bool. Emissive triangles that shine on their front alone."""
        of_object = np.array([name in self.one_sided for name in self.object_names], bool)
        return np.repeat(of_object, np.diff(self.object_offsets))

    @property
    def object_index(self) -> np.ndarray:
        """[M] int32 index of each triangle's object."""
        return np.repeat(np.arange(self.num_objects, dtype=np.int32), np.diff(self.object_offsets))

    @property
    def light_names(self) -> tuple[str, ...]:
        """Names of the objects that emit light, in order."""
        return tuple(self.object_names[number] for number in np.unique(self.object_index[self.is_emissive]))

    @property
    def num_lights(self) -> int:
        """Number of objects that emit light."""
        return len(self.light_names)

    @classmethod
    def from_scene(cls, scene: Scene) -> SceneTriangles:
        """Pack the world-space triangles of a scene, with shading normals and without zero-area triangles.

        Raises:
            SceneError: If nothing of an object is left; names the object.
        """
        objects = scene.objects
        meshes = [item.world_mesh for item in objects]
        return cls(
            positions=np.concatenate([mesh.corners for mesh in meshes]),
            normals=np.concatenate([corner_normals(item.world_mesh, item.material.smooth_shading) for item in objects]),
            material=np.concatenate([_material_rows(item) for item in objects]),
            object_offsets=np.cumsum([0, *map(len, meshes)], dtype=np.int32),
            object_names=tuple(item.name for item in objects),
            one_sided=frozenset(item.name for item in objects if item.material.one_sided),
            texels=Texels.of_all([(item.world_texels, len(item.world_mesh)) for item in objects]),
        )


def _material_rows(item: SceneObject) -> Float[np.ndarray, "f 10"]:
    if (varying := item.world_face_material) is not None:
        return varying
    material, faces = item.material, len(item.world_mesh)
    row = np.array([*material.diffuse, *material.specular, material.roughness, *material.emissive], dtype=np.float32)
    rows = np.tile(row, (faces, 1))
    if material.rand_tri_diffuse_seed is not None:
        rows[:, DIFFUSE] = _random_diffuse(material, item.world_mesh)
    return rows


def _random_diffuse(material: Material, mesh: Mesh) -> Float[np.ndarray, "f 3"]:
    """Draw one 8-bit color per triangle or per smoothly shaded part."""
    by_part = material.smooth_shading and material.random_diffuse_type == "per-shading-group"
    groups = shading_groups(mesh, smooth=by_part)
    # the legacy generator, as in RenderFormer's converter: the same seed gives the same colors
    rng = np.random.RandomState(material.rand_tri_diffuse_seed)
    below = max(1, math.ceil(256 * material.random_diffuse_max))
    return rng.randint(0, below, size=(groups.max() + 1, 3))[groups] / 255
