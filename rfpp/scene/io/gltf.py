"""glTF 2.0 (.gltf, .glb): nodes with meshes become parts, and cameras and punctual lights are kept.

Y up becomes Z up. Each primitive of each node in the file's scene (else the first, else all roots) is a part. Skinned
meshes are in the pose of their joints; morph targets and animations are omitted. Candela and lux are divided by 683,
as Blender does in both directions; the strength of emissive materials is radiance already. A camera's `yfov` becomes
the angle along the longer side of its aspect ratio.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from rfpp.errors import SceneError
from rfpp.scene.io.gltf_file import GltfFile
from rfpp.scene.io.gltf_json import (
    CONE,
    FLAG,
    INDEX,
    INDICES,
    MATRIX,
    POSITIVE,
    QUATERNION,
    RGB,
    TEXT,
    VECTOR,
    YFOV,
    Entry,
)
from rfpp.scene.io.gltf_material import GltfSurface
from rfpp.scene.io.gltf_primitive import Geometry
from rfpp.scene.io.gltf_textures import GltfTextures
from rfpp.scene.io.imported_scene import BEYOND, ImportedScene, Part, PunctualLight, name_of, plain_material, z_up
from rfpp.scene.io.limits import require_bounded
from rfpp.scene.io.texture_baking import MOST_TEXELS
from rfpp.scene.io.texture_detail import TEXTURE_TRIANGLES, TexturedPart, detail_notice, with_detail
from rfpp.scene.mesh import Mesh
from rfpp.scene.spec import Camera

_LUMENS_PER_WATT = 683.0
#: Limit of texels of a scene that is sent again after every change.
_RECEIVED_TEXELS = 1 << 18
_PUNCTUAL = "KHR_lights_punctual"


def read_gltf(path: Path, detail: int = TEXTURE_TRIANGLES, most: int | None = None) -> ImportedScene:
    """Read a .gltf or .glb file; see `with_detail`.

    Warns of omitted content. Raises SceneError, without the file's name.
    """
    return _scene(GltfFile.at(path), path, detail, most)


def received_glb(content: bytes, source: Path) -> ImportedScene:
    """Read a GLB file that is not on the disk; warnings name it `source`."""
    return _scene(GltfFile.received(content), source, TEXTURE_TRIANGLES, texels=_RECEIVED_TEXELS)


def load_gltf_meshes(path: Path) -> tuple[Mesh, ...]:
    """Load the meshes of all nodes without materials, Y up. Raises SceneError, without the file's name."""
    reader = _Reader(GltfFile.at(path))
    with np.errstate(all="ignore"):
        placed = [(world, geometry.faces) for index in reader.poses for _, geometry, world in reader.placed(index)]
    if not placed:
        raise SceneError("the mesh has no faces: export it with triangles")
    return tuple(Mesh(vertices, faces) for vertices, faces in placed)


def _scene(
    file: GltfFile, path: Path, detail: int, most: int | None = None, texels: int = MOST_TEXELS
) -> ImportedScene:
    reader = _Reader(file)
    require_bounded(0, sum(map(reader.primitives, reader.poses)))
    reader.textures.require_few_pixels()
    unfinished, punctual_lights, cameras = [], [], []
    with np.errstate(all="ignore"):  # results that are infinite or NaN are refused
        for index in reader.poses:
            unfinished += reader.parts(index)
            cameras += reader.cameras(index)
            punctual_lights += reader.punctual_lights(index)
        parts, added = with_detail(unfinished, detail, most, texels)
    reader.warn(path, added)
    return ImportedScene(path.stem, tuple(parts), tuple(punctual_lights), tuple(cameras))


class _Reader:
    """Reader of one file; `poses` holds the world matrix [4, 4] of every node in its scene, Y up."""

    def __init__(self, file: GltfFile) -> None:
        self.file, self.document = file, file.document
        self.textures = GltfTextures(file)
        self.poses = dict(self._poses())
        self.omitted: dict[str, None] = dict.fromkeys(["animations"] if self.document.items("animations") else [])
        self._omitted_of_materials: set[str] = set()
        self._triangles = self._parts = 0
        self._geometries: dict[str, Geometry | None] = {}

    def primitives(self, index: int) -> int:
        """Return the number of a node's primitives."""
        mesh = self.file.linked(self._node(index), "mesh", "meshes")
        return len(mesh.items("primitives")) if mesh else 0

    def placed(self, index: int) -> Iterator[tuple[Entry, Geometry, Float[np.ndarray, "v 3"]]]:
        """Yield each primitive of a node that has faces, with its geometry and its vertices in the world."""
        node, pose = self._node(index), self.poses[index]
        if "EXT_mesh_gpu_instancing" in node.entry("extensions"):
            raise SceneError("EXT_mesh_gpu_instancing cannot be read: export its instances as nodes")
        mesh, skin = self.file.linked(node, "mesh", "meshes"), self.file.linked(node, "skin", "skins")
        for number in range(len(mesh.items("primitives")) if mesh else 0):
            primitive = mesh.at("primitives", number)
            geometry = self._geometry(primitive)
            if geometry is None:
                self.omitted["points and lines"] = None
                continue
            if primitive.items("targets"):
                self.omitted["morph targets"] = None
            if not len(geometry.faces):
                continue
            self._triangles += len(geometry.faces)
            self._parts += 1
            require_bounded(self._triangles, self._parts)
            if skin and "JOINTS_0" in geometry.attributes and "WEIGHTS_0" in geometry.attributes:
                yield primitive, geometry, geometry.skinned(skin, self.poses)
            else:
                if np.linalg.det(pose[:3, :3]) < 0:  # mirrored
                    geometry = replace(geometry, faces=geometry.faces[:, ::-1])
                yield primitive, geometry, geometry.positions @ pose[:3, :3].T + pose[:3, 3]

    def _geometry(self, primitive: Entry) -> Geometry | None:
        """Return the geometry of a primitive, read once for all nodes that share it."""
        if primitive.where not in self._geometries:
            self._geometries[primitive.where] = Geometry.read(self.file, primitive)
        return self._geometries[primitive.where]

    def parts(self, index: int) -> Iterator[Part | TexturedPart]:
        label = self._label(index)
        mesh = self.file.linked(self._node(index), "mesh", "meshes")
        try:
            for primitive, geometry, world in self.placed(index):
                material, name = self.file.linked(primitive, "material", "materials"), label
                if material and len(mesh.items("primitives")) > 1:
                    name += f" {name_of(material.get('name', TEXT, ''), material.where)}"
                surface = GltfSurface(self.textures, material, geometry)
                self._omitted_of_materials |= surface.omitted
                one_sided = material is not None and not material.get("doubleSided", FLAG, False)
                part = Part(name, z_up(world), geometry.faces, plain_material(len(geometry.faces)),
                            geometry.is_smooth, surface.see_through, one_sided)  # fmt: skip
                yield TexturedPart.whole(part, surface)
        except SceneError as error:
            raise SceneError(f"'{label}': {error}") from None

    def cameras(self, index: int) -> Iterator[Camera]:
        entry, pose = self.file.linked(self._node(index), "camera", "cameras"), self.poses[index]
        if entry is None:
            return
        if entry.get("type", TEXT, "") != "perspective":
            self.omitted["orthographic cameras"] = None
            return
        position, backward, up = z_up(np.stack([pose[:3, 3], pose[:3, 2], pose[:3, 1]]))
        values = {"position": position, "look_at": position - _unit(backward), "up": _unit(up)}
        if not (np.abs([*values.values()]) < BEYOND).all():
            raise SceneError(f"{entry.where}: its node has no pose: export it again")
        yield Camera(
            **{name: tuple(v.tolist()) for name, v in values.items()}, fov=_longer_angle(entry.entry("perspective"))
        )

    def punctual_lights(self, index: int) -> Iterator[PunctualLight]:
        node, pose, label = self._node(index).entry("extensions", _PUNCTUAL), self.poses[index], self._label(index)
        if "light" not in node:
            return
        light = self.document.entry("extensions", _PUNCTUAL).at("lights", node.get("light", INDEX))
        kind = light.get("type", TEXT, "")
        if kind not in ("point", "spot", "directional"):
            raise SceneError(f"'{label}': light of type '{name_of(kind, '')}': choose point, spot or directional")
        strength = np.multiply(
            light.get("color", RGB, (1, 1, 1)), light.get("intensity", POSITIVE, 1) / _LUMENS_PER_WATT
        )
        position, direction = z_up(np.stack([pose[:3, 3], -pose[:3, 2]]))
        if not (np.abs([strength, position, direction]) < BEYOND).all() or not direction.any():
            raise SceneError(f"'{label}': its light is NaN, infinite or too large: export it again")
        spot = light.entry("spot")
        inner, outer = spot.get("innerConeAngle", CONE, 0.0), spot.get("outerConeAngle", CONE, math.pi / 4)
        if inner > outer + 1e-4:  # exporters round
            raise SceneError(f"'{label}': innerConeAngle is larger than outerConeAngle: export it again")
        yield PunctualLight(label, kind, strength, position, _unit(direction), (min(inner, outer), outer))

    def warn(self, path: Path, added: int) -> None:
        if self.textures.used:
            warnings.warn(f"{path}: {detail_notice(self.textures.used, added)}", stacklevel=5)
        if omitted := [*self.omitted, *sorted(self._omitted_of_materials)]:
            warnings.warn(f"{path}: omitted: {', '.join(omitted)}", stacklevel=5)

    def _node(self, index: int) -> Entry:
        return self.document.at("nodes", index)

    def _label(self, index: int) -> str:
        return name_of(self._node(index).get("name", TEXT, ""), f"node_{index}")

    def _poses(self) -> Iterator[tuple[int, Float[np.ndarray, "4 4"]]]:
        """Yield world matrices of the nodes in the scene, parents first. Raises SceneError if they are not a tree."""
        nodes = range(len(self.document.items("nodes")))
        children = {index: self._node(index).get("children", INDICES, []) for index in nodes}
        if self.document.items("scenes"):
            roots = self.document.at("scenes", self.document.get("scene", INDEX, 0)).get("nodes", INDICES, [])
        else:
            roots = sorted(set(nodes) - {child for index in nodes for child in children[index]})
        waiting = [(root, np.eye(4)) for root in reversed(roots)]
        seen: set[int] = set()
        while waiting:
            index, parent = waiting.pop()
            if index in seen:
                raise SceneError(f"nodes.{index} occurs twice in the hierarchy: export it again, as a tree")
            seen.add(index)
            with np.errstate(over="ignore", invalid="ignore"):
                pose = parent @ _matrix(self._node(index))
            yield index, pose
            waiting += [(child, pose) for child in reversed(children[index])]
        if nodes and not seen:
            raise SceneError("no node belongs to its scene: export it again")


def _matrix(node: Entry) -> Float[np.ndarray, "4 4"]:
    if "matrix" in node:
        return np.reshape(node.get("matrix", MATRIX), (4, 4)).T
    matrix = np.eye(4)
    if "rotation" in node and np.linalg.norm(rotation := node.get("rotation", QUATERNION)) > 0:
        matrix[:3, :3] = Rotation.from_quat(rotation).as_matrix()
    matrix[:3, :3] *= node.get("scale", VECTOR, (1, 1, 1))
    matrix[:3, 3] = node.get("translation", VECTOR, (0, 0, 0))
    return matrix


def _longer_angle(perspective: Entry) -> float:
    """Return degrees along the longer side of the image that the camera was made for."""
    if "yfov" not in perspective:
        raise SceneError(f"{perspective.where}.yfov is missing: export it again")
    aspect = max(perspective.get("aspectRatio", POSITIVE, 1.0), 1.0)
    return min(math.degrees(2 * math.atan(aspect * math.tan(perspective.get("yfov", YFOV) / 2))), 179.0)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
