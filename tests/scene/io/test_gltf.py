"""glTF: what stands where, in which material, seen and lit by what."""

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from gltf_files import SQUARE, SQUARE_UV, GltfBuilder

from rfpp.errors import SceneError
from rfpp.scene.camera import camera_to_world
from rfpp.scene.io.gltf import read_gltf
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import pack
from rfpp.scene.triangles import DIFFUSE


def material_row(builder_material: dict, folder: Path) -> np.ndarray:
    builder = GltfBuilder()
    builder.node(builder.primitive(material=builder_material))
    return read_gltf(builder.write(folder)).parts[0].material[0]


def test_a_scene_of_everything_together(tmp_path: Path) -> None:
    """A floor with a texture, a metal box on a turned and moved table, a lamp, a camera: as exporters write them."""
    builder = GltfBuilder()
    uv = {"TEXCOORD_0": builder.accessor(SQUARE_UV)}
    checker = np.full((2, 2, 3), 255) * np.array([[[1], [0]], [[0], [1]]])
    floor = {"pbrMetallicRoughness": {"baseColorTexture": builder.texture(checker), "metallicFactor": 0}}
    metal = {"pbrMetallicRoughness": {"baseColorFactor": [0.9, 0.6, 0.2, 1], "roughnessFactor": 0.25}}
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": 40}}
    glow = {"emissiveFactor": [1, 0.5, 0], "doubleSided": True, "extensions": strength}
    half = math.sqrt(0.5)
    plate = builder.node(builder.primitive(material=metal), name="plate", scale=[0.2, 1, 0.2], translation=[0, 0, 0.25])
    table = builder.node(name="table", children=[plate], rotation=[0, half, 0, half], translation=[0, 0.4, 0])
    builder.node(builder.primitive(material=floor, attributes=uv), name="floor")
    builder.node(builder.primitive(material=glow), name="bulb", scale=[0.1] * 3, translation=[0, 0.9, 0])
    camera = builder.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.5, "aspectRatio": 2.0}})
    builder.node(camera=camera, translation=[0, 0.3, 1.6])
    builder.document["scenes"] = [{"nodes": [table, 2, 3, 4]}]
    with (
        pytest.warns(UserWarning, match=r"scene\.glb: textures \(1\) are seen as they are; .*, for which .* added"),
        pytest.warns(UserWarning, match=r"scene\.glb: emissive parts light the scene and are invisible"),
    ):
        scene = load_scene(builder.write(tmp_path))

    plate, floor, bulb = scene.objects
    assert [item.name for item in scene.objects] == ["plate", "floor", "bulb"]
    # A quarter turn about Y takes glTF's +Z to its +X; its up becomes Z.
    np.testing.assert_allclose(plate.transform.translation, [0.25, 0, 0.4], atol=1e-6)
    np.testing.assert_allclose(np.ptp(plate.mesh.vertices, axis=0), [0.2, 0.2, 0], atol=1e-6)
    np.testing.assert_allclose(plate.material.specular, [0.9, 0.6, 0.2], atol=1e-6)
    assert plate.material.diffuse == (0, 0, 0)
    assert plate.material.roughness == pytest.approx(0.25)
    np.testing.assert_allclose(bulb.material.emissive, [40, 20, 0])
    # Half of the checkerboard is white, on each of the two triangles.
    np.testing.assert_allclose(floor.material.diffuse, [0.5 * 0.96] * 3, atol=0.02)

    packed = pack(scene)
    facing = packed.triangles.normals[~packed.triangles.is_emissive]
    np.testing.assert_allclose(facing, np.broadcast_to([0, 0, 1], facing.shape), atol=1e-5)
    (view,) = scene.cameras
    np.testing.assert_allclose(view.position, [0, -1.6, 0.3], atol=1e-6)
    np.testing.assert_allclose(np.subtract(view.look_at, view.position), [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(camera_to_world(view)[:3, 1], [0, 0, 1], atol=1e-6)
    assert view.fov == pytest.approx(math.degrees(2 * math.atan(2 * math.tan(0.25))))


def test_no_material_is_gray_and_colors_of_vertices_tint(tmp_path: Path) -> None:
    builder = GltfBuilder()
    colors = np.array([[255, 0, 0, 255]] * 4)
    attributes = {"COLOR_0": builder.accessor(colors, "u1", normalized=True)}
    builder.node(builder.primitive(attributes=attributes))
    builder.node(builder.primitive())
    red, gray = read_gltf(builder.write(tmp_path)).parts
    assert red.material[0, 0] > 0.5 > red.material[0, 1] == 0
    assert len(set(gray.material[0, DIFFUSE])) == 1


@pytest.mark.parametrize("sides", [{}, {"doubleSided": False}, {"doubleSided": True}])
def test_light_leaves_the_front_only_unless_a_material_is_double_sided(tmp_path: Path, sides: dict) -> None:
    builder = GltfBuilder()
    builder.node(builder.primitive(material={"emissiveFactor": [1, 1, 1], **sides}))
    builder.node(builder.primitive(material={}), translation=[0, 1, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = load_scene(builder.write(tmp_path))
    one_sided = {item.material.one_sided for item in scene.objects if item.material.is_emissive}
    assert one_sided == {not sides.get("doubleSided", False)}
    assert not any(item.material.one_sided for item in scene.objects if not item.material.is_emissive)


def test_opaque_blending_is_no_transparency(tmp_path: Path) -> None:
    assert material_row({"alphaMode": "BLEND"}, tmp_path)[3] == 1


@pytest.mark.parametrize(("mode", "indices", "faces"), [(5, [0, 1, 3, 2], 2), (6, [0, 1, 2, 3], 2), (4, None, 1)])
def test_strips_fans_and_plain_corners_face_the_same_way(mode: int, indices: list, faces: int, tmp_path: Path) -> None:
    builder = GltfBuilder()
    builder.node(builder.primitive(indices=None if indices is None else np.array(indices), mode=mode))
    (part,) = read_gltf(builder.write(tmp_path)).parts
    a, b, c = np.moveaxis(part.corners, 1, 0)
    assert len(part) == faces
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_mirrored_nodes_still_face_outwards(tmp_path: Path) -> None:
    builder = GltfBuilder()
    builder.node(builder.primitive(), scale=[-1, 1, 1])
    a, b, c = np.moveaxis(read_gltf(builder.write(tmp_path)).parts[0].corners, 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_points_and_lines_animations_and_flat_cameras_are_left_out_with_a_notice(tmp_path: Path) -> None:
    builder = GltfBuilder()
    builder.node(
        builder.primitive(), builder.primitive(mode=1), camera=builder.add("cameras", {"type": "orthographic"})
    )
    builder.document["animations"] = [{}]
    with pytest.warns(UserWarning, match="omitted: animations, points and lines, orthographic cameras"):
        assert len(read_gltf(builder.write(tmp_path)).parts) == 1


@pytest.mark.parametrize(("normals", "smooth"), [(None, False), ([0, 1, 0], False), ([0, 0.8, 0.6], True)])
def test_stored_normals_say_whether_a_surface_is_smooth(normals: list | None, smooth: bool, tmp_path: Path) -> None:
    builder = GltfBuilder()
    attributes = {} if normals is None else {"NORMAL": builder.accessor(np.array([normals] * 4))}
    builder.node(builder.primitive(attributes=attributes))
    assert read_gltf(builder.write(tmp_path)).parts[0].smooth is smooth


def test_a_skin_follows_its_joints(tmp_path: Path) -> None:
    builder = GltfBuilder()
    attributes = {
        "JOINTS_0": builder.accessor(np.array([[0, 1, 0, 0]] * 4), "u1"),
        "WEIGHTS_0": builder.accessor(np.array([[0.25, 0.75, 0, 0]] * 4)),
    }
    inverse = np.stack([np.eye(4), np.eye(4)])
    inverse[1, 3, :3] = [0, -5, 0]  # column-major: bound at a height of 5
    matrices = builder.accessor(inverse.reshape(2, 16))
    joints = [builder.node(), builder.node(translation=[0, 9, 0])]
    builder.document["skins"] = [{"joints": joints, "inverseBindMatrices": matrices}]
    builder.node(builder.primitive(attributes=attributes), skin=0, translation=[100, 0, 0])
    (part,) = read_gltf(builder.write(tmp_path)).parts
    np.testing.assert_allclose(part.vertices[:, 2], 0.75 * 4, atol=1e-6)
    assert np.abs(part.vertices[:, 0]).max() <= 0.5


def test_quantized_positions_are_read(tmp_path: Path) -> None:
    builder = GltfBuilder()
    primitive = builder.primitive()
    primitive["attributes"]["POSITION"] = builder.accessor(SQUARE[0] * 2 * 127, "i1", normalized=True)
    builder.document["extensionsRequired"] = ["KHR_mesh_quantization"]
    builder.node(primitive, scale=[0.5] * 3)
    np.testing.assert_allclose(np.abs(read_gltf(builder.write(tmp_path)).parts[0].vertices).max(axis=0), [0.5, 0.5, 0])


def test_lights_are_in_watts_and_stand_where_their_nodes_do(tmp_path: Path) -> None:
    builder = GltfBuilder()
    builder.node(builder.primitive())
    lights = [{"type": "point", "intensity": 683.0, "color": [1, 0.5, 0]}, {"type": "directional", "intensity": 1366.0}]
    builder.document["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    for index in (0, 1):
        turned = [math.sqrt(0.5), 0, 0, -math.sqrt(0.5)]  # -Z, where lights shine, becomes -Y: straight down
        extension = {"KHR_lights_punctual": {"light": index}}
        builder.node(extensions=extension, translation=[1, 2, 3], rotation=turned)
    point, sun = read_gltf(builder.write(tmp_path)).punctual_lights
    np.testing.assert_allclose(point.strength, [1, 0.5, 0])
    np.testing.assert_allclose(point.position, [1, -3, 2])
    np.testing.assert_allclose(sun.strength, [2, 2, 2])
    np.testing.assert_allclose(sun.direction, [0, 0, -1], atol=1e-12)


def test_cones_of_spots_may_be_rounded_and_no_more(tmp_path: Path) -> None:
    def cone(**angles: float) -> tuple[float, float]:
        builder = GltfBuilder()
        builder.node(builder.primitive())
        lights = [{"type": "spot", "intensity": 683.0, "spot": angles}]
        builder.document["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
        builder.node(name="Spot", extensions={"KHR_lights_punctual": {"light": 0}})
        return read_gltf(builder.write(tmp_path)).punctual_lights[0].cone

    assert cone() == (0, math.pi / 4)
    assert cone(innerConeAngle=0.3, outerConeAngle=0.5) == (0.3, 0.5)
    assert cone(innerConeAngle=0.50000001, outerConeAngle=0.5) == (0.5, 0.5)
    with pytest.raises(SceneError, match="'Spot': innerConeAngle is larger than outerConeAngle: export it again"):
        cone(innerConeAngle=0.6, outerConeAngle=0.5)
    with pytest.raises(SceneError, match="outerConeAngle"):
        cone(outerConeAngle=2.0)


def test_the_same_scene_with_its_buffer_anywhere(tmp_path: Path) -> None:
    builder = GltfBuilder()
    builder.node(builder.primitive(), builder.primitive(), name="a\nb  c")
    (tmp_path / "my data.bin").write_bytes(builder.binary)
    (tmp_path / "apart.gltf").write_bytes(builder.gltf("my%20data.bin"))
    parts = [read_gltf(builder.write(tmp_path, name)).parts for name in ("in.glb", "data.gltf")]
    parts.append(read_gltf(tmp_path / "apart.gltf").parts)
    for first, second in parts:
        assert first.name == second.name == "a b c"
        np.testing.assert_array_equal(first.vertices, parts[0][0].vertices)


def test_loading_is_silent_where_nothing_was_changed(tmp_path: Path) -> None:
    builder = GltfBuilder()
    builder.node(builder.primitive())
    camera = builder.add("cameras", {"type": "perspective", "perspective": {"yfov": 0.7}})
    builder.node(camera=camera, translation=[0, 1, 1.5])
    lights = [{"type": "point", "intensity": 683.0 * 20}]
    builder.document["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    builder.node(extensions={"KHR_lights_punctual": {"light": 0}}, translation=[0, 2, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = load_scene(builder.write(tmp_path))
    assert len(scene.objects) == 2
