"""GLB files of the add-on, read by our reader."""

from pathlib import Path

import numpy as np
from addon_modules import addon

from rfpp.scene.io.gltf import received_glb
from rfpp.scene.io.gltf_file import GltfFile
from rfpp.scene.triangles import EMISSION

glb = addon("glb")
SQUARE = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
FACES = np.array([0, 1, 2, 0, 2, 3], np.uint32)


def test_files_are_read_in_the_coordinates_of_blender():
    file = glb.Glb()
    primitive = {"attributes": {"POSITION": file.array(SQUARE)}, "indices": file.array(FACES)}
    pose = np.array([[0, -2, 0, 5], [2, 0, 0, 6], [0, 0, 2, 7], [0, 0, 0, 1]], float)
    file.node("Square", pose, mesh=file.add("meshes", {"primitives": [primitive]}))
    lamp = {"type": "spot", "color": [1, 0.5, 0], "intensity": 683.0}
    file.node("Lamp", np.eye(4), extensions=file.light(lamp))
    scene = received_glb(file.content(), Path("scene"))
    [part], [light] = scene.parts, scene.punctual_lights
    np.testing.assert_allclose(part.vertices, SQUARE @ pose[:3, :3].T + pose[:3, 3])
    np.testing.assert_array_equal(part.faces.reshape(-1), FACES)
    np.testing.assert_allclose([*light.strength, *light.direction], [1, 0.5, 0, 0, 0, -1])
    assert not part.material[:, EMISSION].any()


def test_lengths_and_buffers_are_sound():
    file = glb.Glb()
    file.array(np.arange(5, dtype=np.float32))
    content = file.content()
    assert len(content) % 4 == 0 and int.from_bytes(content[8:12], "little") == len(content)
    np.testing.assert_array_equal(GltfFile.received(content).array(0, "SCALAR"), np.arange(5))
