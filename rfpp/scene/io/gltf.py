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
from jaxtyping import Float

from rfpp.errors import SceneError
from rfpp.scene.io.gltf_file import GltfFile
from rfpp.scene.io.gltf_material import GltfMaterials
from rfpp.scene.io.gltf_primitive import Geometry
from rfpp.scene.io.gltf_schema import Camera as CameraEntry
from rfpp.scene.io.gltf_schema import Node, Primitive
from rfpp.scene.io.imported_scene import BEYOND, ImportedScene, Lamp, Part, name_of, z_up
from rfpp.scene.io.limits import require_bounded
from rfpp.scene.spec import Camera

_LUMENS_PER_WATT = 683.0


def read_gltf(path: Path) -> ImportedScene:
    """The scene in a .gltf or .glb file.

    Warns of what is left out. Raises SceneError, without the file's name.
    """
    return _scene(GltfFile.at(path), path)


def received_glb(content: bytes, source: Path) -> ImportedScene:
    """Like `read_gltf`, of a GLB file that is not on the disk; `source` is what warnings call it."""
    return _scene(GltfFile.received(content), source)


def _scene(file: GltfFile, path: Path) -> ImportedScene:
    reader = _Reader(file)
    reader.materials.require_few_pixels()
    parts, lamps, cameras = [], [], []
    with np.errstate(all="ignore"):  # what becomes infinite or NaN is refused
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
        self._triangles = self._parts = 0

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
                self._parts += 1
                require_bounded(self._triangles, self._parts)
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
        if not (np.abs([*values.values()]) < BEYOND).all():
            raise SceneError(f"cameras.{node.camera}: its node has no pose: export it again")
        yield Camera(**{name: tuple(v.tolist()) for name, v in values.items()}, fov=_longer_angle(entry))

    def lamps(self, node: Node, label: str, pose: np.ndarray) -> Iterator[Lamp]:
        if node.extensions.light is None:
            return
        light = self.file.entry(self.document.extensions.lights.lights, node.extensions.light.light, "lights")
        if light.type not in ("point", "spot", "directional"):
            raise SceneError(f"'{label}': light of type '{name_of(light.type, '')}': choose point, spot or directional")
        strength = np.multiply(light.color, light.intensity / _LUMENS_PER_WATT)
        position, direction = z_up(np.stack([pose[:3, 3], -pose[:3, 2]]))
        if not (np.abs([strength, position, direction]) < BEYOND).all() or not direction.any():
            raise SceneError(f"'{label}': its light is NaN, infinite or too large: export it again")
        yield Lamp(label, light.type, strength, position, _unit(direction))

    def warn(self, path: Path) -> None:
        if textures := self.materials.textures.used:
            warnings.warn(f"{path}: textures are averaged over each triangle ({textures})", stacklevel=5)
        if self.materials.normal_maps:
            self.left_out["normal maps"] = None
        if self.left_out:
            warnings.warn(f"{path}: left out: {', '.join(self.left_out)}", stacklevel=5)

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
        geometry = Geometry.read(self.file, primitive)
        if geometry is None:
            self.left_out["points and lines"] = None
            return None
        if primitive.targets:
            self.left_out["morph targets"] = None
        self._triangles += len(geometry.faces)
        require_bounded(self._triangles)
        if not len(geometry.faces):
            return None

        faces = geometry.faces
        if node.skin is not None and {"JOINTS_0", "WEIGHTS_0"} <= primitive.attributes.keys():
            world = geometry.skinned(self.file.entry(self.document.skins, node.skin, "skins"), self.poses)
        else:
            world = geometry.positions @ pose[:3, :3].T + pose[:3, 3]
            faces = faces[:, ::-1] if np.linalg.det(pose[:3, :3]) < 0 else faces
        material, present, see_through = self.materials.rows(
            primitive.material, len(faces), geometry.coordinates, geometry.colours
        )
        if primitive.material is not None and len(self.document.meshes[node.mesh].primitives) > 1:
            label += f" {name_of(self.document.materials[primitive.material].name, str(primitive.material))}"
        return Part(label, z_up(world), faces, material, geometry.is_smooth, see_through).only(present)


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
