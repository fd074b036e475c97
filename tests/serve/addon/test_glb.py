"""GLB files that the add-on writes, as our reader sees them."""

import io
from pathlib import Path

import numpy as np
from addon_modules import addon
from PIL import Image

from rfpp.scene.io.gltf import received_glb
from rfpp.scene.io.gltf_file import GltfFile
from rfpp.scene.triangles import EMISSION

glb, left_out = addon("glb"), addon("left_out")
SQUARE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
FACES = np.array([0, 1, 2, 0, 2, 3], np.uint32)


def test_what_was_written_is_read_where_blender_has_it():
    file = glb.Glb()
    primitive = {"attributes": {"POSITION": file.array(SQUARE)}, "indices": file.array(FACES)}
    pose = np.array([[0, -2, 0, 5], [2, 0, 0, 6], [0, 0, 2, 7], [0, 0, 0, 1]], float)
    file.node("Square", pose, mesh=file.add("meshes", {"primitives": [primitive]}))
    lamp = {"type": "spot", "color": [1, 0.5, 0], "intensity": 683.0}
    file.node("Lamp", np.eye(4), extensions=file.light(lamp))
    camera = addon("viewport").gltf_camera((-0.5, 0.5, -0.25, 0.25))
    file.node("Camera", pose, camera=file.add("cameras", camera))
    scene = received_glb(file.content(), Path("scene"))
    [part], [light], [seen] = scene.parts, scene.lamps, scene.cameras
    np.testing.assert_allclose(part.vertices, SQUARE @ pose[:3, :3].T + pose[:3, 3])
    np.testing.assert_array_equal(part.faces.reshape(-1), FACES)
    np.testing.assert_allclose([*light.strength, *light.direction], [1, 0.5, 0, 0, 0, -1])
    np.testing.assert_allclose(seen.position, (5, 6, 7))
    np.testing.assert_allclose(seen.fov, 2 * np.degrees(np.arctan(0.5)))
    assert not part.material[:, EMISSION].any()


def test_a_file_is_whole():
    file = glb.Glb()
    file.array(np.arange(5, dtype=np.float32))
    content = file.content()
    assert len(content) % 4 == 0 and int.from_bytes(content[8:12], "little") == len(content)
    np.testing.assert_array_equal(GltfFile.received(content).array(0, "SCALAR"), np.arange(5))


def test_pictures_are_png():
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 4), np.uint8)
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(glb.png(pixels)))), pixels)


def test_what_is_left_out_is_listed_by_kind():
    collected = left_out.LeftOut()
    for name in "abcdef":
        collected.add("Hair is left out", name)
    collected.add("Hair is left out", "a")
    collected.add("Motion blur is left out")
    assert collected.lines() == ["Hair is left out: a, b, c, d and 2 more", "Motion blur is left out"]
