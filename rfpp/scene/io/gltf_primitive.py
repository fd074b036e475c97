"""Triangles of one glTF primitive: positions, faces and the attributes of its vertices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from rfpp.errors import SceneError
from rfpp.scene.io.gltf_file import GltfFile
from rfpp.scene.io.gltf_json import INDEX, INDICES, Entry
from rfpp.scene.io.imported_scene import is_smooth

_TRIANGLES, _STRIP, _FAN = 4, 5, 6


@dataclass(frozen=True, eq=False)
class Geometry:
    """A primitive of triangles.

    Attributes:
        positions: [V, 3] float64, before any transform.
        faces: [F, 3] indices into them.
    """

    file: GltfFile
    attributes: Entry
    positions: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    _coordinates: dict[int, Float[np.ndarray, "f 3 2"]] = field(default_factory=dict, init=False)

    @classmethod
    def read(cls, file: GltfFile, primitive: Entry) -> Geometry | None:
        """Return None for points and lines. Raises SceneError: compressed, without positions, a bad index."""
        for extension in ("KHR_draco_mesh_compression", "EXT_meshopt_compression"):
            if extension in primitive.entry("extensions"):
                raise SceneError(f"{extension} cannot be read: export it without mesh compression")
        mode, attributes = primitive.get("mode", INDEX, _TRIANGLES), primitive.entry("attributes")
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            return None
        if "POSITION" not in attributes:
            raise SceneError("a primitive has no POSITION: export it again")
        positions = file.array(attributes.get("POSITION", INDEX), "VEC3").astype(np.float64)
        corners = np.arange(len(positions))
        if "indices" in primitive:
            corners = file.array(primitive.get("indices", INDEX), "SCALAR")
            if corners.dtype.kind != "u":
                raise SceneError("its indices are not unsigned integers: export it again")
            corners = corners.astype(np.int64)
        faces = _triangles(corners, mode)
        if len(faces) and faces.max() >= len(positions):
            raise SceneError(f"a face refers to vertex {faces.max():,} of {len(positions):,}: export it again")
        return cls(file, attributes, positions, faces)

    @property
    def corners(self) -> Float[np.ndarray, "f 3 3"]:
        """Positions of each face's corners."""
        return self.positions[self.faces]

    @property
    def is_smooth(self) -> bool:
        """True if stored normals differ from those of the faces; without any, glTF surfaces are flat."""
        if "NORMAL" not in self.attributes:
            return False
        return is_smooth(self.positions, self.faces, self._attribute("NORMAL", "VEC3"), self.faces)

    @cached_property
    def colors(self) -> Float[np.ndarray, "f 3 4"] | None:
        """Color of each face's corners, linear, with alpha."""
        if "COLOR_0" not in self.attributes:
            return None
        colors = np.clip(self._attribute("COLOR_0", "VEC3", "VEC4"), 0, 1)
        opaque = np.ones((len(colors), 4))
        opaque[:, : colors.shape[1]] = colors
        return opaque[self.faces]

    def coordinates(self, number: int) -> Float[np.ndarray, "f 3 2"]:
        """Return the texture coordinates of each face's corners."""
        name = f"TEXCOORD_{number}"
        if name not in self.attributes:
            raise SceneError(f"a texture needs {name}, which the mesh does not have: unwrap the mesh")
        if number not in self._coordinates:
            self._coordinates[number] = self._attribute(name, "VEC2")[self.faces]
        return self._coordinates[number]

    def skinned(self, skin: Entry, poses: Mapping[int, np.ndarray]) -> Float[np.ndarray, "v 3"]:
        """Return world positions of a mesh that follows joints (node → pose), not its own node."""
        indices = skin.get("joints", INDICES, [])
        if any(joint not in poses for joint in indices):
            raise SceneError("a joint of its skin is not in the scene: export it again")
        bones = np.stack([poses[joint] for joint in indices]) if indices else np.empty((0, 4, 4))
        if "inverseBindMatrices" in skin:
            inverse = self.file.array(skin.get("inverseBindMatrices", INDEX), "MAT4").astype(np.float64)
            if len(inverse) < len(bones):
                raise SceneError("its skin does not have a matrix for each joint: export it again")
            bones = bones @ inverse[: len(bones)].reshape(-1, 4, 4).transpose(0, 2, 1)
        joints, weights = self._attribute("JOINTS_0", "VEC4").astype(np.int64), self._attribute("WEIGHTS_0", "VEC4")
        if joints.max() >= len(bones) or joints.min() < 0:
            raise SceneError("its skin is damaged: export it again")
        first = np.arange(0, weights.size + 1, weights.shape[1])
        blend = csr_array((weights.reshape(-1), joints.reshape(-1), first), shape=(len(weights), len(bones)))
        pose = (blend @ bones[:, :3].reshape(-1, 12)).reshape(-1, 3, 4)
        posed = np.einsum("vij,vj->vi", pose[..., :3], self.positions) + pose[..., 3]
        return posed / np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)

    def _attribute(self, name: str, *types: str) -> Float[np.ndarray, "v n"]:
        values = self.file.array(self.attributes.get(name, INDEX), *types).astype(np.float64)
        if len(values) != len(self.positions) or not np.isfinite(values).all():
            raise SceneError(f"its {name} is damaged: export it again")
        return values


def _triangles(corners: Int[np.ndarray, " n"], mode: int) -> Int[np.ndarray, "f 3"]:
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    first = np.arange(max(len(corners) - 2, 0))
    if mode == _FAN:
        return corners[np.stack([np.zeros_like(first), first + 1, first + 2], axis=1)]
    odd = first % 2  # every other triangle of a strip is wound the other way
    return corners[np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)]
