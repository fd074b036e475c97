"""Run by tests of the add-on inside Blender: install the zip file, create a scene, render it.

`in_blender.py <zip> <server> <function> <arguments>`; imports nothing of this project.
"""

from __future__ import annotations

import importlib
import math
import sys
import time
from types import SimpleNamespace

import bpy
import numpy as np

MODULE = "bl_ext.user_default.rfpp"


def main(extension: str, server: str, function: str, *arguments: str) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=extension, repo="user_default", enable_on_install=True)
    bpy.context.preferences.addons[MODULE].preferences.address = server
    bpy.context.scene.render.engine = "RFPP"
    globals()[function](*arguments)


def render_and_export(picture: str, gltf: str) -> None:
    """Render a scene through the add-on, and export it to a file."""
    furnished()
    rendered(picture)
    bpy.ops.export_scene.gltf(filepath=gltf, export_cameras=True, export_lights=True, export_apply=True)


def render_parts(whole: str, shifted: str, part: str) -> None:
    """Render a picture, the same through a shifted lens, and a region of it."""
    scene = furnished()
    rendered(whole)
    camera = scene.camera.data
    camera.shift_x, camera.shift_y = 0.1, -0.05  # of the longer side
    rendered(shifted)
    camera.shift_x = camera.shift_y = 0.0
    scene.render.use_border = scene.render.use_crop_to_border = True
    scene.render.border_min_x, scene.render.border_max_x = 0.25, 0.75
    scene.render.border_min_y, scene.render.border_max_y = 0.5, 1.0
    rendered(part)


def render_transparent(picture: str) -> None:
    scene = furnished()
    scene.render.film_transparent = True
    rendered(picture)


def render_unsupported(picture: str) -> None:
    """Render some of everything that the add-on warns of."""
    scene = furnished()
    world = bpy.data.worlds.new("Sky")
    world.use_nodes = True
    scene.world = world
    area_light("SQUARE", scene)
    plain, mixed = bpy.data.materials.new("Plain"), principled("Glazed", (0.5, 0.5, 0.5))
    mixed.inputs["Coat Weight"].default_value = 0.5
    mixed.inputs["Transmission Weight"].default_value = 1.0
    tree = mixed.id_data
    bump = tree.nodes.new("ShaderNodeBump")
    tree.links.new(bump.outputs["Normal"], mixed.inputs["Normal"])
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs[0], mixed.inputs["Roughness"])
    plain.use_nodes = True
    plain.node_tree.nodes.remove(plain.node_tree.nodes["Principled BSDF"])
    glass = plain.node_tree.nodes.new("ShaderNodeBsdfGlass")
    plain.node_tree.links.new(glass.outputs[0], plain.node_tree.nodes["Material Output"].inputs["Surface"])
    for x, material in ((-1, plain), (1, bpy.data.materials["Glazed"])):
        bpy.ops.mesh.primitive_cube_add(size=0.5, location=(x, -1, 0.25))
        bpy.context.object.data.materials.append(material)
    bpy.ops.object.volume_add()
    scene.camera.data.dof.use_dof = True
    rendered(picture)


def render_orthographic(picture: str) -> None:
    """Render through a camera without perspective."""
    furnished().camera.data.type = "ORTHO"
    try:
        rendered(picture)
    except RuntimeError as error:
        print(f"refused: {error}")


def render_without_server() -> None:
    furnished()
    try:
        bpy.ops.render.render()
    except RuntimeError as error:
        print(f"refused: {error}")


def disable() -> None:
    """Disable the add-on, list its traces, and enable it again."""
    bpy.ops.preferences.addon_disable(module=MODULE)
    panels = [panel for panel in bpy.types.Panel.__subclasses__() if panel.is_registered]
    left = [panel.__name__ for panel in panels if "RFPP" in getattr(panel, "COMPAT_ENGINES", ())]
    print(f"left: {left}, {hasattr(bpy.types.Scene, 'rfpp')}, {is_engine()}")
    bpy.ops.preferences.addon_enable(module=MODULE)
    print(f"again: {is_engine()}")


def light_in_cycles(kind: str, picture: str, sent: str) -> None:
    """Render a floor under a light in Cycles, and export it as the add-on does."""
    scene = bpy.context.scene
    floor(6.0)
    if kind in ("SPOT", "SUN"):
        light = bpy.data.lights.new("Lamp", kind)
        light.energy, light.color = 200.0 if kind == "SPOT" else 3.0, (1.0, 0.6, 0.3)
        if kind == "SPOT":
            light.spot_size, light.spot_blend, light.shadow_soft_size = math.radians(50), 0.3, 0.0
        aimed(bpy.data.objects.new("Lamp", light), (2.2, 0.5, 2.5), (-0.2, 0.8, 0))  # its shade hides no lit place
    else:
        area_light(kind, scene)
    camera(scene, (0, 0, 5), (0, 0, 0))
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = 256, False, False
    scene.cycles.max_bounces, scene.render.threads_mode, scene.render.threads = 0, "FIXED", 1
    rendered(picture, 24, 24)
    export = importlib.import_module(f"{MODULE}.scene_export")
    content, _ = export.exported(bpy.context.evaluated_depsgraph_get(), {})
    with open(sent, "wb") as file:
        file.write(content)


def render_beside_cycles(picture: str, cycles: str, width: str = "96", height: str = "64") -> None:
    """Render with walls that reflect light in both engines."""
    scene = furnished()
    for place, turn in (((0, 2, 2), (math.pi / 2, 0, 0)), ((-2, 0, 2), (math.pi / 2, 0, math.pi / 2))):
        bpy.ops.mesh.primitive_plane_add(size=4, location=place, rotation=turn)
        principled("Wall", (0.75, 0.7, 0.65), Roughness=0.9)
        bpy.context.object.data.materials.append(bpy.data.materials["Wall"])
    aimed(scene.camera, (1.2, -3.6, 1.8), (-0.15, 0.2, 0.6))
    rendered(picture, int(width), int(height))
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 256, True
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    rendered(cycles, int(width), int(height))


def look_in_a_viewport(picture: str) -> None:
    """Request the pictures of a viewport while its camera moves, without drawing them."""
    scene, module = furnished(), importlib.import_module(f"{MODULE}.viewport")
    scene.rfpp.viewport_pixels, depsgraph = 96, bpy.context.evaluated_depsgraph_get()
    viewport = module.Viewport()
    viewport.update(depsgraph)
    looks = scene.camera.calc_matrix_camera(depsgraph, x=960, y=540)
    region = SimpleNamespace(is_perspective=True, window_matrix=looks)
    context = SimpleNamespace(region=SimpleNamespace(width=960, height=540), region_data=region)
    for x in np.linspace(-0.4, 0, 20):
        scene.camera.location[0] = x
        bpy.context.view_layer.update()
        region.view_matrix = scene.camera.matrix_world.inverted()
        print(f"said: {viewport.want(context, depsgraph)}")
    begin = time.monotonic()
    while viewport.is_busy and time.monotonic() - begin < 120:
        time.sleep(0.01)
    np.save(picture, viewport.picture)
    region.is_perspective = False
    print(f"said: {viewport.want(context, depsgraph)}")


def furnished():
    """Create a textured floor, a glossy ball, a head of two materials with a modifier, two lights and a camera."""
    scene = bpy.context.scene
    floor(4.0)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.5, location=(0.7, 0.2, 0.5), segments=24, ring_count=12)
    bpy.ops.object.shade_smooth()
    ball = principled("Red", (0.8, 0.05, 0.03), Roughness=0.3)
    ball.inputs["Specular IOR Level"].default_value = 0.8
    bpy.context.object.data.materials.append(bpy.data.materials["Red"])
    bpy.ops.mesh.primitive_monkey_add(size=0.9, location=(-0.6, 0.3, 0.5), rotation=(-0.5, 0, 0.4))
    bpy.ops.object.modifier_add(type="SUBSURF")
    modifier = bpy.context.object.modifiers[0]
    modifier.levels = modifier.render_levels = 1  # exports use the viewport's, F12 uses the render's
    head = bpy.context.object.data
    for name, color in (("Brass", (0.8, 0.6, 0.2)), ("Blue", (0.1, 0.2, 0.8))):
        principled(name, color, Metallic=1.0 if name == "Brass" else 0.0)
        head.materials.append(bpy.data.materials[name])
    head.polygons.foreach_set("material_index", np.arange(len(head.polygons)) % 2)
    for kind, place, watts in (("POINT", (1.0, -1.5, 2.5), 80.0), ("SPOT", (-1.5, -1.0, 2.5), 200.0)):
        light = bpy.data.lights.new(kind.capitalize(), kind)
        light.energy, light.color = watts, (1.0, 0.9, 0.7)
        if kind == "SPOT":
            light.spot_blend = 0.0  # Blender's exporter blends by the angle, Cycles and the add-on by its cosine
        aimed(bpy.data.objects.new(kind.capitalize(), light), place, (0, 0, 0.4))
    camera(scene, (0, -4, 2), (0, 0, 0.4))
    return scene


def floor(size: float) -> None:
    """Create a textured floor."""
    bpy.ops.mesh.primitive_grid_add(size=size, x_subdivisions=12, y_subdivisions=12)
    pixels = np.ones((32, 32, 4), np.float32)
    pixels[:16, :, :3], pixels[16:, :, :3] = (0.6, 0.6, 0.5), (0.3, 0.5, 0.4)
    image = bpy.data.images.new("Halves", 32, 32)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    shader = principled("Floor", (1, 1, 1), Roughness=1.0)
    node = shader.id_data.nodes.new("ShaderNodeTexImage")
    node.image = image
    shader.id_data.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    bpy.context.object.data.materials.append(bpy.data.materials["Floor"])


def area_light(shape: str, scene) -> None:
    light = bpy.data.lights.new("Panel", "AREA")
    light.shape, light.size, light.size_y, light.energy, light.color = shape, 0.8, 0.4, 60.0, (1.0, 0.6, 0.3)
    aimed(bpy.data.objects.new("Panel", light), (0.3, 0.2, 2.5), (0, 0, 0))


def camera(scene, place, towards) -> None:
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.camera.data.angle = math.radians(45)
    aimed(scene.camera, place, towards)


def aimed(item, place, towards) -> None:
    from mathutils import Vector

    if item.name not in bpy.context.scene.collection.objects:
        bpy.context.scene.collection.objects.link(item)
    item.location = place
    item.rotation_euler = (Vector(towards) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.view_layer.update()


def principled(name: str, color, **inputs: float):
    """Create a material and return its shader."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    for key, value in inputs.items():
        shader.inputs[key].default_value = value
    return shader


def rendered(path: str, width: int = 96, height: int = 64) -> None:
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    image = scene.render.image_settings
    image.file_format, image.color_depth, image.color_mode = "OPEN_EXR", "32", "RGBA"
    scene.view_settings.view_transform = "Raw"
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)


def is_engine() -> bool:
    """Return whether Blender offers the engine."""
    try:
        bpy.context.scene.render.engine = "RFPP"
    except TypeError:
        return False
    return True


if __name__ == "__main__":
    main(*sys.argv[1:])
