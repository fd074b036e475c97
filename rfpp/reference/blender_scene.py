"""Convert packed triangles to Blender meshes and materials. `bpy` is an argument, never imported here.

Materials follow RenderFormer's data: the sum of a Lambertian lobe and a multiple-scattering GGX lobe, without a Fresnel
term. Emissive triangles keep their reflectance, emit on both sides and are invisible to the camera.
"""

from __future__ import annotations

from collections.abc import Collection
from types import ModuleType

import numpy as np

from rfpp.errors import SceneError
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR, SceneTriangles

#: Materials of one mesh that differ in more than the diffuse albedo; more become attributes of the mesh.
_MOST_SLOTS = 64


def add_geometry(bpy: ModuleType, triangles: SceneTriangles) -> None:
    """Add every object to Blender's scene; partly emissive objects are split in two.

    Raises:
        SceneError: If a triangle of an object has no area or is not finite; names the object.
    """
    _check_geometry(triangles)
    emissive = triangles.is_emissive
    for index, name in enumerate(triangles.object_names):
        members = np.arange(triangles.object_offsets[index], triangles.object_offsets[index + 1])
        for part in (members[~emissive[members]], members[emissive[members]]):
            if len(part):
                obj = bpy.data.objects.new(name, _mesh(bpy, name, triangles, part))
                obj.pass_index = index + 1
                obj.visible_camera = not emissive[part[0]]
                bpy.context.collection.objects.link(obj)


def _check_geometry(triangles: SceneTriangles) -> None:
    """Reject geometry with which Blender crashes or renders incorrectly."""
    edges = triangles.positions[:, 1:] - triangles.positions[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1)
    sound = np.isfinite(triangles.positions).all((1, 2)) & np.isfinite(triangles.normals).all((1, 2)) & (area > 0)
    if not sound.all():
        name = triangles.object_names[triangles.object_index[np.argmin(sound)]]
        raise SceneError(f"object '{name}': a triangle has no area or is not finite: repair the mesh")


def _mesh(bpy: ModuleType, name: str, triangles: SceneTriangles, part: np.ndarray):
    """Return a Blender mesh of unconnected triangles with their normals and materials."""
    count = len(part)
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(3 * count)
    mesh.vertices.foreach_set("co", _flat(triangles.positions[part]))
    mesh.loops.add(3 * count)
    mesh.loops.foreach_set("vertex_index", np.arange(3 * count, dtype=np.int32))
    mesh.polygons.add(count)
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))

    rows = triangles.material[part]
    diffuse, others = rows[:, DIFFUSE], np.delete(rows, DIFFUSE, axis=1)
    varying = {"diffuse": diffuse} if (diffuse != diffuse[0]).any() else {}
    _, first, slot = np.unique(others, axis=0, return_index=True, return_inverse=True)
    if len(first) > _MOST_SLOTS:
        first, slot = np.zeros(1, np.int64), np.zeros(count, np.int64)
        roughness = np.repeat(rows[:, ROUGHNESS], 3, axis=1)
        varying |= {"specular": rows[:, SPECULAR], "roughness": roughness, "emission": rows[:, EMISSION]}
    for row in rows[first]:
        mesh.materials.append(_material(bpy, row, varying.keys(), name in triangles.one_sided))
    mesh.polygons.foreach_set("material_index", slot.reshape(-1).astype(np.int32))
    for attribute, values in varying.items():
        colors = mesh.color_attributes.new(attribute, "FLOAT_COLOR", "CORNER")
        colors.data.foreach_set("color", _flat(np.insert(np.repeat(values, 3, axis=0), 3, 1, axis=1)))

    mesh.update(calc_edges=True)
    # setting normals on an unvalidated mesh crashes Blender
    if mesh.validate() or len(mesh.polygons) != count:
        raise SceneError(f"object '{name}': Blender reports invalid triangles: repair the mesh")
    mesh.polygons.foreach_set("use_smooth", np.ones(count, bool))
    mesh.normals_split_custom_set_from_vertices(triangles.normals[part].reshape(-1, 3))
    return mesh


def _material(bpy: ModuleType, row: np.ndarray, attributes: Collection[str], is_one_sided: bool):
    """Return diffuse + GGX (+ emission) for one row of `SceneTriangles.material`.

    Args:
        attributes: Names of those that vary over the mesh and are attributes of it.
    """
    material = bpy.data.materials.new("surface")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()

    def node(kind: str, **inputs):
        new = tree.nodes.new(kind)
        for name, value in inputs.items():
            new.inputs[name].default_value = value
        return new

    def added(first, second):
        total = tree.nodes.new("ShaderNodeAddShader")
        tree.links.new(first.outputs[0], total.inputs[0])
        tree.links.new(second.outputs[0], total.inputs[1])
        return total

    def varies(shader, socket: str, name: str, output: str = "Color") -> None:
        if name in attributes:
            attribute = tree.nodes.new("ShaderNodeAttribute")
            attribute.attribute_name = name
            tree.links.new(attribute.outputs[output], shader.inputs[socket])

    diffuse = node("ShaderNodeBsdfDiffuse", Color=_rgba(row[DIFFUSE]), Roughness=0.0)
    varies(diffuse, "Color", "diffuse")
    glossy = node("ShaderNodeBsdfAnisotropic", Color=_rgba(row[SPECULAR]), Roughness=float(row[ROUGHNESS][0]))
    glossy.distribution = "MULTI_GGX"
    varies(glossy, "Color", "specular")
    varies(glossy, "Roughness", "roughness", "Fac")
    surface = added(diffuse, glossy)
    strength = 1.0 if "emission" in attributes else float(row[EMISSION].max())
    if row[EMISSION].max() > 0:
        light = node("ShaderNodeEmission", Color=_rgba(row[EMISSION] / strength), Strength=strength)
        varies(light, "Color", "emission")
        surface = added(surface, _on_front(tree, light) if is_one_sided else light)
        material.cycles.emission_sampling = "FRONT" if is_one_sided else "FRONT_BACK"
    tree.links.new(surface.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def _on_front(tree, light):
    """Return a shader that is the light's on the front and black on the back."""
    mix = tree.nodes.new("ShaderNodeMixShader")
    tree.links.new(tree.nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"], mix.inputs["Fac"])
    tree.links.new(light.outputs[0], mix.inputs[1])
    return mix


def _flat(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float32).reshape(-1)


def _rgba(rgb: np.ndarray) -> tuple[float, float, float, float]:
    return (*(float(value) for value in rgb), 1.0)
