"""Export an evaluated scene as a GLB file."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from .glb import Glb
from .lights import add_light
from .materials import Materials, Warnings, constant, surface_of, tree_of

#: Types of objects with surfaces, of objects that nothing shows, and of unsupported ones.
_SURFACES = {"MESH", "CURVE", "SURFACE", "FONT", "META"}
_INVISIBLE = {"EMPTY", "ARMATURE", "LATTICE", "SPEAKER", "CAMERA"}
_UNSUPPORTED = {"VOLUME": "Volumes are omitted", "CURVES": "Hair is omitted", "POINTCLOUD": "Point clouds are omitted"}
#: Names in one line of warnings.
_NAMES = 4


def exported(depsgraph, pngs: dict[str, bytes]) -> tuple[bytes, list[str]]:
    """Return a depsgraph as a GLB file, and warnings about its deviations; `pngs` as for `Materials`."""
    glb, warnings = Glb(), defaultdict(list)
    meshes = _Meshes(glb, Materials(glb, warnings, pngs), warnings)
    for instance in depsgraph.object_instances:
        item, matrix = instance.object, np.array(instance.matrix_world, np.float64)
        if not instance.is_instance and any(system.settings.type == "HAIR" for system in item.particle_systems):
            warnings["Hair is omitted"].append(item.name)
        if not instance.show_self:
            continue
        if not (np.abs(matrix) < 1e15).all():
            warnings["Objects without a finite position are omitted"].append(item.name)
        elif item.type == "LIGHT":
            add_light(glb, item.data, item.name, matrix, warnings)
        elif item.type in _SURFACES:
            if (mesh := meshes.index(item)) is not None:
                glb.node(item.name, matrix, mesh=mesh)
        elif item.type not in _INVISIBLE:
            warnings[_UNSUPPORTED.get(item.type, f"{item.type} is omitted")].append(item.name)
    _warn_of_settings(depsgraph.scene, warnings)
    return glb.content(), [f"{kind}: {_listed(list(dict.fromkeys(names)))}" for kind, names in warnings.items()]


def _listed(names: list[str]) -> str:
    return ", ".join(names[:_NAMES]) + (f" and {len(names) - _NAMES} more" if len(names) > _NAMES else "")


def _warn_of_settings(scene, warnings: Warnings) -> None:
    if scene.world is not None and _emits(scene.world):
        warnings["Light of the world is omitted"].append(scene.world.name)
    if scene.camera is not None and scene.camera.type == "CAMERA" and scene.camera.data.dof.use_dof:
        warnings["Depth of field is omitted"].append(scene.camera.name)
    if scene.render.use_motion_blur:
        warnings["Motion blur is omitted"].append(scene.name)


def _emits(world) -> bool:
    if tree_of(world) is None:
        return max(world.color) > 0
    background = surface_of(world)
    if background is None or background.type != "BACKGROUND":
        return background is not None
    color, strength = (constant(background.inputs[key]) for key in ("Color", "Strength"))
    return color is None or strength is None or strength * max(color[:3]) > 0


class _Meshes:
    """Exporter that writes each mesh once, however many objects use it."""

    def __init__(self, glb: Glb, materials: Materials, warnings: Warnings) -> None:
        self._glb, self._materials, self._warnings = glb, materials, warnings
        self._indices: dict[tuple, int | None] = {}

    def index(self, item) -> int | None:
        """Return the index of an evaluated object's mesh; None if it has no faces."""
        slots = tuple(None if slot.material is None else slot.material.name_full for slot in item.material_slots)
        key = (item.data.as_pointer(), slots)
        if item.type != "MESH":  # the evaluated mesh is not its data
            key = (item.name_full, *key)
        if key not in self._indices:
            mesh = item.to_mesh()
            try:
                primitives = [] if mesh is None else self._primitives(item, mesh)
            finally:
                item.to_mesh_clear()
            entry = {"name": item.data.name, "primitives": primitives}
            self._indices[key] = self._glb.add("meshes", entry) if primitives else None
        return self._indices[key]

    def _primitives(self, item, mesh) -> list[dict]:
        mesh.calc_loop_triangles()
        triangles = mesh.loop_triangles
        if not len(triangles):
            return []
        corners = _read(triangles, "loops", 3, np.int32)
        positions = _read(mesh.vertices, "co", 3)[_read(mesh.loops, "vertex_index", 1, np.int32)[:, 0]]
        if not np.isfinite(positions).all():
            self._warnings["Meshes that are not finite are omitted"].append(item.name)
            return []
        attributes = {"POSITION": positions, "NORMAL": _read(mesh.corner_normals, "vector", 3)}
        if mesh.uv_layers.active is not None:
            attributes["TEXCOORD_0"] = _read(mesh.uv_layers.active.uv, "vector", 2) * (1, -1) + (0, 1)
        slots = item.material_slots
        slot = np.minimum(_read(triangles, "material_index", 1, np.int32)[:, 0], max(len(slots) - 1, 0))
        primitives = []
        for number in np.unique(slot):
            chosen = corners[slot == number].reshape(-1)
            entry = {"attributes": {name: self._glb.array(values[chosen]) for name, values in attributes.items()}}
            if len(slots) and slots[number].material is not None:
                entry["material"] = self._materials.index(slots[number].material)
            primitives.append(entry)
        return primitives


def _read(collection, name: str, width: int, dtype=np.float32) -> np.ndarray:
    """Return a property of all elements [n, width]."""
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(name, values)
    return values.reshape(-1, width)
