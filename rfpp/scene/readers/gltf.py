"""glTF 2.0 (.gltf, .glb): nodes with meshes become parts, with cameras cameras, with punctual lights lamps.

Y up becomes Z up. Of the scene that the file names (else the first, else all roots), each primitive of each node is a
part. Skinned meshes stand in the pose of their joints, morph targets and animations are left out. Lights: candela and
lux are divided by 683, as Blender does in both directions, so that a scene exported from it is as bright here; the
strength of emissive materials is radiance already. A camera's `yfov` becomes the angle along the longer side of its
aspect ratio.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from rfpp.errors import SceneError
from rfpp.scene.readers.gltf_file import GltfFile
from rfpp.scene.readers.gltf_material import GltfMaterials
from rfpp.scene.readers.gltf_schema import Camera as CameraEntry
from rfpp.scene.readers.gltf_schema import Node, Primitive
from rfpp.scene.readers.imported import ImportedScene, Lamp, Part, name_of, z_up
from rfpp.scene.spec import Camera
from rfpp.scene.untrusted import require_bounded

_LUMENS_PER_WATT = 683.0
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
#: Corners whose stored normals lie farther from their face's than this (1 degree) belong to smooth surfaces.
_FLAT_COSINE = math.cos(math.radians(1))


def read_gltf(path: Path) -> ImportedScene:
    """The scene in a .gltf or .glb file.

    Warns of what is left out. Raises SceneError, without the file's name.
    """
    reader = _Reader(GltfFile(path))
    parts, lamps, cameras = [], [], []
    with np.errstate(over="ignore", invalid="ignore"):  # what becomes infinite is refused by Part
        for index, pose in reader.poses.items():
            node = reader.document.nodes[index]
            label = name_of(node.name, f"node_{index}")
            parts += reader.parts(node, label, pose)
            cameras += reader.cameras(node, pose)
            lamps += reader.lamps(node, label, pose)
    reader.warn(path)
    return ImportedScene(path.stem, tuple(parts), tuple(lamps), tuple(cameras))


class _Reader:
    """One file; `poses` holds node → world matrix [4, 4] of every node in its scene, Y up."""

    def __init__(self, file: GltfFile) -> None:
        self.file, self.document = file, file.document
        self.materials = GltfMaterials(file)
        self.poses = dict(self._poses())
        self.left_out: dict[str, None] = dict.fromkeys(["animations"] if self.document.animations else [])
        self._triangles = 0

    def parts(self, node: Node, label: str, pose: np.ndarray) -> Iterator[Part]:
        if node.extensions.instancing is not None:
            raise SceneError(f"'{label}': EXT_mesh_gpu_instancing cannot be read: export its instances as nodes")
        if node.mesh is None:
            return
        for primitive in self.file.entry(self.document.meshes, node.mesh, "meshes").primitives:
            try:
                part = self._part(primitive, node, label, pose)
            except SceneError as error:
                raise SceneError(f"'{label}': {error}") from None
            if part is not None and len(part):
                yield part

    def cameras(self, node: Node, pose: np.ndarray) -> Iterator[Camera]:
        if node.camera is None:
            return
        entry = self.file.entry(self.document.cameras, node.camera, "cameras")
        if entry.type != "perspective" or entry.perspective is None:
            self.left_out["orthographic cameras"] = None
            return
        position, backward, up = z_up(np.stack([pose[:3, 3], pose[:3, 2], pose[:3, 1]]))
        values = {"position": position, "look_at": position - _unit(backward), "up": _unit(up)}
        yield Camera(**{name: tuple(v.tolist()) for name, v in values.items()}, fov=_longer_angle(entry))

    def lamps(self, node: Node, label: str, pose: np.ndarray) -> Iterator[Lamp]:
        if node.extensions.light is None:
            return
        light = self.file.entry(self.document.extensions.lights.lights, node.extensions.light.light, "lights")
        if light.type not in ("point", "spot", "directional"):
            raise SceneError(f"'{label}': light of type '{name_of(light.type, '')}': choose point, spot or directional")
        strength = np.multiply(light.color, light.intensity / _LUMENS_PER_WATT)
        position, direction = z_up(np.stack([pose[:3, 3], -pose[:3, 2]]))
        if not np.isfinite([strength, position, direction]).all():
            raise SceneError(f"'{label}': its light is beyond every number: export it again")
        yield Lamp(label, light.type, strength, position, _unit(direction))

    def warn(self, path: Path) -> None:
        if self.materials.textures:
            warnings.warn(f"{path}: {self.materials.textures} textures are averaged over each triangle", stacklevel=4)
        if self.materials.normal_maps:
            self.left_out["normal maps"] = None
        if self.left_out:
            warnings.warn(f"{path}: left out: {', '.join(self.left_out)}", stacklevel=4)

    def _poses(self) -> Iterator[tuple[int, Float[np.ndarray, "4 4"]]]:
        """World matrices of the nodes in the scene, parents first. Raises SceneError where they are no tree."""
        document = self.document
        if document.scenes:
            roots = self.file.entry(document.scenes, document.scene or 0, "scenes").nodes
        else:
            children = {child for node in document.nodes for child in node.children}
            roots = [index for index in range(len(document.nodes)) if index not in children]
        waiting = [(root, np.eye(4)) for root in reversed(roots)]
        seen: set[int] = set()
        while waiting:
            index, parent = waiting.pop()
            if index in seen:
                raise SceneError(f"nodes.{index} occurs twice in the hierarchy: export it again, as a tree")
            seen.add(index)
            node = self.file.entry(document.nodes, index, "nodes")
            with np.errstate(over="ignore", invalid="ignore"):
                pose = parent @ _matrix(node)
            yield index, pose
            waiting += [(child, pose) for child in reversed(node.children)]
        if document.nodes and not seen:
            raise SceneError("no node belongs to its scene: export it again")

    def _part(self, primitive: Primitive, node: Node, label: str, pose: np.ndarray) -> Part | None:
        for extension in ("KHR_draco_mesh_compression", "EXT_meshopt_compression"):
            if extension in primitive.extensions:
                raise SceneError(f"{extension} cannot be read: export it without mesh compression")
        if primitive.mode not in (_TRIANGLES, _STRIP, _FAN):
            self.left_out["points and lines"] = None
            return None
        if primitive.targets:
            self.left_out["morph targets"] = None
        if "POSITION" not in primitive.attributes:
            raise SceneError("a primitive has no POSITION: export it again")
        positions = self._attribute(primitive, "POSITION", "VEC3")
        faces = self._faces(primitive, len(positions))
        if not len(faces):
            return None
        if faces.max() >= len(positions):
            raise SceneError(f"a face refers to vertex {faces.max():,} of {len(positions):,}: export it again")
        self._triangles += len(faces)
        require_bounded(self._triangles)

        smooth = self._is_smooth(primitive, positions, faces)
        colours = self._colours(primitive, faces, len(positions))
        material, present = self.materials.rows(
            primitive.material, len(faces), lambda number: self._coordinates(primitive, number, faces, len(positions)),
            colours,
        )  # fmt: skip
        world = self._posed(primitive, node, positions, pose)
        if np.linalg.det(pose[:3, :3]) < 0 and node.skin is None:
            faces = faces[:, ::-1]
        name = label
        if primitive.material is not None and len(self.document.meshes[node.mesh].primitives) > 1:
            name = f"{label} {name_of(self.document.materials[primitive.material].name, str(primitive.material))}"
        return Part(name, z_up(world), faces, material, smooth).only(present)

    def _attribute(self, primitive: Primitive, name: str, *types: str) -> np.ndarray:
        return self.file.array(primitive.attributes[name], *types).astype(np.float64)

    def _faces(self, primitive: Primitive, vertices: int) -> Int[np.ndarray, "f 3"]:
        if primitive.indices is None:
            corners = np.arange(vertices)
        else:
            corners = self.file.array(primitive.indices, "SCALAR")
            if corners.dtype.kind not in "ui":
                raise SceneError("its indices are no integers: export it again")
            corners = corners.astype(np.int64)
        if primitive.mode == _TRIANGLES:
            return corners[: len(corners) // 3 * 3].reshape(-1, 3)
        first = np.arange(max(len(corners) - 2, 0))
        if primitive.mode == _FAN:
            return corners[np.stack([np.zeros_like(first), first + 1, first + 2], axis=1)]
        odd = first % 2  # every other triangle of a strip is wound the other way
        return corners[np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)]

    def _is_smooth(self, primitive: Primitive, positions: np.ndarray, faces: np.ndarray) -> bool:
        """By the stored normals; without any, glTF says flat."""
        if "NORMAL" not in primitive.attributes:
            return False
        normals = self._attribute(primitive, "NORMAL", "VEC3")
        if len(normals) != len(positions):
            raise SceneError("it has not as many normals as positions: export it again")
        a, b, c = np.moveaxis(positions[faces], 1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            of_faces, of_corners = _unit(np.cross(b - a, c - a)), _unit(normals[faces])
            return bool((np.abs((of_corners * of_faces[:, None]).sum(-1)) < _FLAT_COSINE).any())

    def _colours(self, primitive: Primitive, faces: np.ndarray, vertices: int) -> Float[np.ndarray, "f 4"] | None:
        if "COLOR_0" not in primitive.attributes:
            return None
        colours = np.clip(self._attribute(primitive, "COLOR_0", "VEC3", "VEC4"), 0, 1)
        if len(colours) != vertices or not np.isfinite(colours).all():
            raise SceneError("its vertex colours are damaged: export it again")
        opaque = np.ones((len(colours), 4))
        opaque[:, : colours.shape[1]] = colours
        return opaque[faces].mean(axis=1).astype(np.float32)

    def _coordinates(
        self, primitive: Primitive, number: int, faces: np.ndarray, vertices: int
    ) -> Float[np.ndarray, "f 3 2"]:
        name = f"TEXCOORD_{number}"
        if name not in primitive.attributes:
            raise SceneError(f"a texture needs {name}, which the mesh has not: unwrap the mesh or drop the texture")
        coordinates = self._attribute(primitive, name, "VEC2")
        if len(coordinates) != vertices or not np.isfinite(coordinates).all():
            raise SceneError("its texture coordinates are damaged: export it again")
        return coordinates[faces]

    def _posed(self, primitive: Primitive, node: Node, positions: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """World positions; a skinned mesh follows its joints and not its node."""
        if node.skin is None or not {"JOINTS_0", "WEIGHTS_0"} <= primitive.attributes.keys():
            return positions @ pose[:3, :3].T + pose[:3, 3]
        skin = self.file.entry(self.document.skins, node.skin, "skins")
        if any(joint not in self.poses for joint in skin.joints):
            raise SceneError("a joint of its skin is not in the scene: export it again")
        bones = np.stack([self.poses[joint] for joint in skin.joints])
        if skin.inverse_bind_matrices is not None:
            inverse = self.file.array(skin.inverse_bind_matrices, "MAT4").astype(np.float64)
            if len(inverse) < len(bones):
                raise SceneError("its skin has not a matrix for each joint: export it again")
            bones = bones @ inverse[: len(bones)].reshape(-1, 4, 4).transpose(0, 2, 1)
        joints = self.file.array(primitive.attributes["JOINTS_0"], "VEC4").astype(np.int64)
        weights = self._attribute(primitive, "WEIGHTS_0", "VEC4")
        if not len(joints) == len(weights) == len(positions) or joints.max() >= len(bones) or joints.min() < 0:
            raise SceneError("its skin is damaged: export it again")
        posed = np.zeros_like(positions)
        for joint, weight in zip(joints.T, weights.T, strict=True):
            moved = np.einsum("vij,vj->vi", bones[joint][:, :3, :3], positions) + bones[joint][:, :3, 3]
            posed += weight[:, None] * moved
        return posed / np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)


def _matrix(node: Node) -> Float[np.ndarray, "4 4"]:
    """Node to parent."""
    if node.matrix is not None:
        return np.reshape(node.matrix, (4, 4)).T
    x, y, z, w = np.divide(node.rotation, max(np.linalg.norm(node.rotation), 1e-12))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation * node.scale, node.translation
    return matrix


def _longer_angle(camera: CameraEntry) -> float:
    """Degrees along the longer side of the image that the camera was made for."""
    aspect = max(camera.perspective.aspect_ratio or 1.0, 1.0)
    return min(math.degrees(2 * math.atan(aspect * math.tan(camera.perspective.yfov / 2))), 179.0)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
