"""glTF as Blender reads it: the same surfaces in the same place, lit as brightly."""

import tempfile
import warnings
from pathlib import Path

import numpy as np
import pytest
from gltf_files import GltfBuilder
from marks import requires_blender

from rfpp.imaging.exr import read_exr
from rfpp.reference.cycles import CyclesSettings, render
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import pack

pytestmark = requires_blender

SIZE = 24
SETTINGS = CyclesSettings(
    samples=64, adaptive_threshold=0.0, denoise=False, max_bounces=4, diffuse_bounces=4, glossy_bounces=4,
    clamp_direct=0.0, clamp_indirect=0.0, caustics=False, blur_glossy=0.0, light_threshold=0.0, filter_width=1.5,
    seed=0, threads=1,
)  # fmt: skip


def render_import(path: Path, image: Path) -> None:
    """What Blender's own importer makes of the file. In a process that may import Blender."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(path))
    scene = bpy.context.scene
    scene.camera = next(item for item in scene.objects if item.type == "CAMERA")
    scene.world = bpy.data.worlds.new("dark")
    scene.world.color = (0, 0, 0)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = 64, False, False
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.filepath = str(image)
    bpy.ops.render.render(write_still=True)


def room(light: dict) -> GltfBuilder:
    """A floor, a wall and a turned box of different colors, twenty metres large and away from the origin."""
    builder = GltfBuilder()

    def dull(*color: float) -> dict:
        pbr = {"baseColorFactor": [*color, 1], "metallicFactor": 0, "roughnessFactor": 1}
        return {"pbrMetallicRoughness": pbr, "extensions": {"KHR_materials_specular": {"specularFactor": 0}}}

    quarter = np.sqrt(0.5)
    floor = builder.node(builder.primitive(material=dull(0.7, 0.7, 0.7)), scale=[20, 1, 20])
    wall = builder.node(
        builder.primitive(material=dull(0.8, 0.2, 0.1)),
        scale=[20, 1, 20], rotation=[quarter, 0, 0, quarter], translation=[0, 10, -10],
    )  # fmt: skip
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (0, 4) for z in (-1, 1)], float)
    faces = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    box = builder.node(
        builder.primitive(corners, faces[:, [0, 1, 2, 0, 2, 3]].ravel(), dull(0.1, 0.3, 0.8)),
        rotation=[0, np.sin(0.3), 0, np.cos(0.3)], translation=[2, 0, 1],
    )  # fmt: skip
    camera = builder.add(
        "cameras", {"type": "perspective", "perspective": {"yfov": 0.7, "aspectRatio": 1.0, "znear": 0.1}}
    )
    eye = builder.node(camera=camera, rotation=[-np.sin(0.15), 0, 0, np.cos(0.15)], translation=[0, 10, 22])
    builder.document["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    builder.document["extensionsUsed"] = ["KHR_lights_punctual", "KHR_materials_specular"]
    down = [-np.sin(0.65), 0, 0, np.cos(0.65)]
    extension = {"KHR_lights_punctual": {"light": 0}}
    lamp = builder.node(extensions=extension, rotation=down, translation=[-3, 12, 4])
    root = builder.node(children=[floor, wall, box, eye, lamp], translation=[100, 0, 50])
    builder.document |= {"scenes": [{"nodes": [root]}], "scene": 0}
    return builder


@pytest.mark.parametrize(
    ("light", "tolerance"),
    [
        ({"type": "point", "intensity": 683.0 * 300, "color": [1, 0.8, 0.6]}, 0.1),
        # Its triangle is near: right at the box's center, a quarter too dark on the floor, too bright above.
        ({"type": "directional", "intensity": 683.0 * 3}, 0.35),
    ],
    ids=["point", "directional"],
)
def test_a_scene_is_as_bright_and_lies_where_blender_has_it(light: dict, tolerance: float, in_process) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = room(light).write(Path(folder))
        in_process(render_import, path, Path(folder) / "truth.exr")
        truth = next(layer for layer in read_exr(Path(folder) / "truth.exr").values() if layer.ndim == 3)[..., :3]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = pack(load_scene(path))
    image = in_process(render, scene.triangles, scene.c2w, scene.fov, SIZE, SIZE, SETTINGS)[0]
    assert np.abs(image - truth).mean() / truth.mean() < tolerance
    np.testing.assert_allclose(image.mean(axis=(0, 1)), truth.mean(axis=(0, 1)), rtol=tolerance)
