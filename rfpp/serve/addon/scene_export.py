"""An evaluated scene as a GLB file."""

from __future__ import annotations

import numpy as np

from .glb import Glb
from .left_out import LeftOut
from .lights import add_light
from .materials import Materials
from .nodes import constant, surface_of, tree_of
from .viewport import NoView, camera_window, gltf_camera, is_finite

#: Kinds of objects that have surfaces, as `to_mesh` gives them, and that are nothing to be seen.
_SURFACES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
_INVISIBLE = {"EMPTY", "ARMATURE", "LATTICE", "SPEAKER", "CAMERA"}
_OTHERS = {
    "VOLUME": "Volumes are left out",
    "CURVES": "Hair is left out",
    "POINTCLOUD": "Point clouds are left out",
    "LIGHT_PROBE": "Light probes are left out",
}


def exported(depsgraph, pictures: dict[str, bytes]) -> tuple[bytes, list[str]]:
    """A GLB file of what a depsgraph shows, and lines on what that leaves out.

    Args:
        pictures: see `Materials`.
    """
    glb, left_out = Glb(), LeftOut()
    meshes = _Meshes(glb, Materials(glb, left_out, pictures), left_out)
    for instance in depsgraph.object_instances:
        item, matrix = instance.object, np.array(instance.matrix_world, np.float64)
        if not instance.is_instance and any(system.settings.type == "HAIR" for system in item.particle_systems):
            left_out.add("Hair is left out", item.name)
        if not instance.show_self:
            continue
        if not is_finite(matrix):
            left_out.add("Objects that are nowhere are left out", item.name)
        elif item.type == "LIGHT":
            add_light(glb, item.data, item.name, matrix, left_out)
        elif item.type in _SURFACES:
            if (mesh := meshes.number(item)) is not None:
                glb.node(item.name, matrix, mesh=mesh)
        elif item.type not in _INVISIBLE:
            left_out.add(_OTHERS.get(item.type, f"{item.type.replace('_', ' ').capitalize()} is left out"), item.name)
    _add_camera(glb, depsgraph)
    _look_around(depsgraph.scene, left_out)
    return glb.content(), left_out.lines()


def _add_camera(glb: Glb, depsgraph) -> None:
    """The scene's: lights that are added to a scene in the dark are set up about it."""
    scene = depsgraph.scene_eval
    if scene.camera is None:
        return
    camera = scene.camera.evaluated_get(depsgraph)
    try:
        window = camera_window(camera, depsgraph, (scene.render.resolution_y, scene.render.resolution_x))
    except NoView:
        return
    matrix = np.array(camera.matrix_world.normalized(), np.float64)
    glb.node(camera.name, matrix, camera=glb.add("cameras", gltf_camera(window)))


def _look_around(scene, left_out: LeftOut) -> None:
    """What concerns all of the scene."""
    if scene.world is not None and _shines(scene.world):
        left_out.add("Light of the world is left out", scene.world.name)
    if scene.camera is not None and scene.camera.type == "CAMERA" and scene.camera.data.dof.use_dof:
        left_out.add("Depth of field is left out", scene.camera.name)
    if scene.render.use_motion_blur:
        left_out.add("Motion blur is left out")


def _shines(world) -> bool:
    """As far as is easily told."""
    if tree_of(world) is None:
        return max(world.color) > 0
    background = surface_of(world)
    if background is None or background.type != "BACKGROUND":
        return background is not None
    colour, strength = (constant(background.inputs[key]) for key in ("Color", "Strength"))
    return colour is None or strength is None or strength * max(colour[:3]) > 0


class _Meshes:
    """Each mesh once, however often it stands in the scene."""

    def __init__(self, glb: Glb, materials: Materials, left_out: LeftOut) -> None:
        self._glb, self._materials, self._left_out = glb, materials, left_out
        self._numbers: dict[tuple, int | None] = {}

    def number(self, item) -> int | None:
        """Of the mesh of an evaluated object; None where it has no faces."""
        slots = tuple(None if slot.material is None else slot.material.name_full for slot in item.material_slots)
        key = (item.data.as_pointer(), slots)
        if item.type != "MESH":  # whose data is not what is shown
            key = (item.name_full, *key)
        if key not in self._numbers:
            self._numbers[key] = self._made(item)
        return self._numbers[key]

    def _made(self, item) -> int | None:
        mesh = item.to_mesh()
        try:
            primitives = [] if mesh is None else self._primitives(item, mesh)
        finally:
            item.to_mesh_clear()
        return self._glb.add("meshes", {"name": item.data.name, "primitives": primitives}) if primitives else None

    def _primitives(self, item, mesh) -> list[dict]:
        """One for each material."""
        mesh.calc_loop_triangles()
        triangles = mesh.loop_triangles
        if not len(triangles):
            return []
        corners = _read(triangles, "loops", 3, np.int32)
        positions = _read(mesh.vertices, "co", 3)[_read(mesh.loops, "vertex_index", 1, np.int32)[:, 0]]
        if not np.isfinite(positions).all():
            self._left_out.add("Meshes that are not finite are left out", item.name)
            return []
        attributes = {"POSITION": positions, "NORMAL": _read(mesh.corner_normals, "vector", 3)}
        if mesh.uv_layers.active is not None:
            attributes["TEXCOORD_0"] = _read(mesh.uv_layers.active.uv, "vector", 2) * (1, -1) + (0, 1)
        slot = np.minimum(_read(triangles, "material_index", 1, np.int32)[:, 0], max(len(item.material_slots) - 1, 0))
        primitives = []
        for number in np.unique(slot):
            chosen = corners[slot == number].reshape(-1)
            entry = {"attributes": {name: self._glb.array(values[chosen]) for name, values in attributes.items()}}
            material = item.material_slots[number].material if len(item.material_slots) else None
            if (index := self._materials.number(material)) is not None:
                entry["material"] = index
            primitives.append(entry)
        return primitives


def _read(collection, name: str, width: int, dtype=np.float32) -> np.ndarray:
    """[n, width] of a property of every element."""
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(name, values)
    return values.reshape(-1, width)
