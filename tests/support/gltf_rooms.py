"""glTF files of a room, each with one feature that readers get wrong silently, and Blender's pictures of them."""

from pathlib import Path

import numpy as np
from gltf_files import SQUARE, SQUARE_UV, GltfBuilder

POINT = {"type": "point", "intensity": 683.0 * 300, "color": [1, 0.8, 0.6]}
SUN = {"type": "directional", "intensity": 683.0 * 3}
SPOT = {"type": "spot", "intensity": 683.0 * 300, "spot": {"innerConeAngle": 0.3, "outerConeAngle": 0.5}}
_BOX = np.array([[x, y, z] for x in (-1, 1) for y in (0, 4) for z in (-1, 1)], float)
_BOX_FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
_DOWN = [-np.sin(0.65), 0, 0, np.cos(0.65)]


def matte(*color: float) -> dict:
    """A material without highlights."""
    pbr = {"baseColorFactor": [*color, 1], "metallicFactor": 0, "roughnessFactor": 1}
    return {"pbrMetallicRoughness": pbr, "extensions": {"KHR_materials_specular": {"specularFactor": 0}}}


def room(light: dict | None = None, wall: dict | None = None, box: dict | None = None, quantized=False) -> GltfBuilder:
    """A floor, a wall and a turned box of different colors, twenty meters large and away from the origin.

    Args:
        light: of KHR_lights_punctual, above the box.
        wall, box: Materials.
        quantized: Whether the box's positions are 16-bit integers.
    """
    builder, quarter = GltfBuilder(), np.sqrt(0.5)
    floor = builder.node(builder.primitive(material=matte(0.7, 0.7, 0.7)), scale=[20, 20, 20])
    coordinates = {"TEXCOORD_0": builder.accessor(SQUARE_UV)}
    back = builder.node(
        builder.primitive(material=wall or matte(0.8, 0.2, 0.1), attributes=coordinates),
        scale=[20, 20, 20], rotation=[quarter, 0, 0, quarter], translation=[0, 10, -10],
    )  # fmt: skip
    corners = builder.primitive(_BOX, _BOX_FACES[:, [0, 1, 2, 0, 2, 3]].ravel(), box or matte(0.1, 0.3, 0.8))
    if quantized:
        corners["attributes"]["POSITION"] = builder.accessor(_BOX * 8000, "i2")
    turned = {"rotation": [0, np.sin(0.3), 0, np.cos(0.3)], "translation": [2, 0, 1]}
    block = builder.node(corners, **turned, **({"scale": [1 / 8000] * 3} if quantized else {}))
    perspective = {"yfov": 0.7, "aspectRatio": 1.0, "znear": 0.1}
    camera = builder.add("cameras", {"type": "perspective", "perspective": perspective})
    eye = builder.node(camera=camera, rotation=[-np.sin(0.15), 0, 0, np.cos(0.15)], translation=[0, 10, 22])
    builder.document["extensionsUsed"] = ["KHR_materials_specular"]
    children = [floor, back, block, eye]
    if light:
        builder.document["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
        builder.document["extensionsUsed"] += ["KHR_lights_punctual"]
        lamp = {"KHR_lights_punctual": {"light": 0}}
        children.append(builder.node(extensions=lamp, rotation=_DOWN, translation=[-3, 12, 4]))
    root = builder.node(children=children, translation=[100, 0, 50])
    builder.document |= {"scenes": [{"nodes": [root]}], "scene": 0}
    return builder


def bricks() -> GltfBuilder:
    """A wall of two triangles with a picture of bricks."""
    y, x = np.mgrid[:128, :128]
    is_joint = (y % 16 < 2) | ((x + 16 * (y // 16 % 2)) % 32 < 2)
    pixels = np.where(is_joint[..., None], [200, 200, 190], [150, 60, 40])
    builder = room(POINT)
    material = builder.document["materials"][1]
    material["pbrMetallicRoughness"] |= {"baseColorFactor": [1, 1, 1, 1], "baseColorTexture": builder.texture(pixels)}
    return builder


def bumps() -> GltfBuilder:
    """A wall with a normal map of domes."""
    y, x = np.mgrid[-4:4:256j, -4:4:256j] % 1 - 0.5
    inside = x**2 + y**2 < 0.2
    normals = np.dstack([np.where(inside, 1.5 * x, 0), np.where(inside, -1.5 * y, 0), np.full_like(x, 1)])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    builder = room(POINT)
    builder.document["materials"][1]["normalTexture"] = builder.texture(np.round(normals * 127.5 + 127.5))
    return builder


def leaves() -> GltfBuilder:
    """Cards with cut-out disks, in front of the wall."""
    builder = room(POINT)
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    pixels = np.dstack([np.full((64, 64, 3), [40, 120, 30]), np.where(x**2 + y**2 < 0.6, 255, 0)])
    pbr = {"baseColorTexture": builder.texture(pixels), "metallicFactor": 0, "roughnessFactor": 1}
    material = builder.add("materials", matte(1, 1, 1) | {"pbrMetallicRoughness": pbr, "alphaMode": "MASK",
                                                          "doubleSided": True})  # fmt: skip
    rng, root = np.random.default_rng(0), builder.document["nodes"][-1]
    for place in rng.uniform([-7, 2, -8], [7, 10, -2], (24, 3)):
        card = builder.primitive(SQUARE[0], SQUARE[1], attributes={"TEXCOORD_0": builder.accessor(SQUARE_UV)})
        turn = rng.normal(size=4)
        root["children"].append(
            builder.node(card | {"material": material}, scale=[2.5] * 3, translation=place.tolist(),
                         rotation=(turn / np.linalg.norm(turn)).tolist())
        )  # fmt: skip
    return builder


def glossy() -> GltfBuilder:
    """A box with KHR_materials_pbrSpecularGlossiness."""
    values = {"diffuseFactor": [0.7, 0.5, 0.1, 1], "specularFactor": [0.04] * 3, "glossinessFactor": 0.1}
    builder = room(POINT, box={"extensions": {"KHR_materials_pbrSpecularGlossiness": values}})
    builder.document["extensionsUsed"] += ["KHR_materials_pbrSpecularGlossiness"]
    return builder


def screen() -> GltfBuilder:
    """No lamp, but a panel behind the camera with an emissive texture, bright on one half."""
    builder = room()
    pixels = np.zeros((128, 128, 3))  # so many that Cycles' interpolation between gamma values does not matter
    pixels[:, 64:] = [255, 220, 180]
    material = {"emissiveFactor": [1, 1, 1], "emissiveTexture": builder.texture(pixels),
                "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 20}},
                "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]}}  # fmt: skip
    builder.document["extensionsUsed"] += ["KHR_materials_emissive_strength"]
    uv = {"TEXCOORD_0": builder.accessor(SQUARE_UV)}
    lamp = builder.node(
        builder.primitive(material=material, attributes=uv),
        scale=[8, 1, 8], rotation=[-np.sin(np.pi / 4 + 0.2), 0, 0, np.cos(np.pi / 4 + 0.2)], translation=[0, 14, 24],
    )  # fmt: skip
    builder.document["nodes"][-2]["children"].append(lamp)
    return builder


ROOMS = {
    "point": lambda: room(POINT), "sun": lambda: room(SUN), "spot": lambda: room(SPOT), "bricks": bricks,
    "bumps": bumps, "leaves": leaves, "specular-glossiness": glossy, "emissive texture": screen,
    "quantized": lambda: room(POINT, quantized=True),
}  # fmt: skip


def blender_picture(path: Path, image: Path, size: int, samples: int) -> None:
    """Write what Blender's own importer makes of the file. In a process that may import Blender."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(path))
    scene = bpy.context.scene
    scene.camera = next(item for item in scene.objects if item.type == "CAMERA")
    scene.world = bpy.data.worlds.new("dark")
    scene.world.color = (0, 0, 0)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = samples, False, False
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.filepath = str(image)
    bpy.ops.render.render(write_still=True)
