"""Pictures and normal maps are seen by cameras pixel by pixel, however few triangles there are."""

import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from gltf_files import SQUARE_UV, GltfBuilder
from known_scenes import look_at

from rfpp import Renderer
from rfpp.errors import SceneError
from rfpp.inference.materials import MaterialTensors
from rfpp.raycast.direct_light import direct_radiance
from rfpp.raycast.first_hit import GBuffer, channel, first_hit
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.scene.io.loading import load_scene
from rfpp.scene.mesh import Mesh
from rfpp.scene.packed import pack
from rfpp.scene.spec import Material, Scene, SceneObject

SIDE, FOV = 96, 2 * np.degrees(np.arctan(0.5))
ABOVE = look_at((0, 0, 1), up=(0, 1, 0))  # whose picture is the square
NOISE = np.random.default_rng(0).integers(0, 256, (48, 48, 3))
#: The same in larger squares.
COARSE = NOISE[:12, :12].repeat(4, 0).repeat(4, 1)
LAMP = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 683.0}]}}


def scene(pixels: np.ndarray | None = NOISE, normals: np.ndarray | None = None, mirrored=False, **options) -> Scene:
    """A square of side 1 on the floor with a picture and a normal map, lit from above; undivided."""
    builder = GltfBuilder()
    pbr = {"metallicFactor": 0, "roughnessFactor": 1}
    pbr |= {} if pixels is None else {"baseColorTexture": builder.texture(pixels)}
    material = {"pbrMetallicRoughness": pbr} | ({} if normals is None else {"normalTexture": builder.texture(normals)})
    uv = {"TEXCOORD_0": builder.accessor(SQUARE_UV)}
    floor = builder.node(builder.primitive(material=material, attributes=uv), scale=[-1 if mirrored else 1, 1, 1])
    lamp = builder.node(extensions={"KHR_lights_punctual": {"light": 0}}, translation=[0.3, 2, 0.5])
    builder.document |= {"extensions": LAMP, "extensionsUsed": ["KHR_lights_punctual"]}
    builder.document |= {"scenes": [{"nodes": [floor, lamp]}], "scene": 0}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_scene(builder.write(Path(folder)), detail=0, **options)


def linear(pixels: np.ndarray) -> np.ndarray:
    value = pixels / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def seen(of: Scene, pose: np.ndarray = ABOVE, side: int = SIDE) -> tuple[GBuffer, np.ndarray]:
    triangles = pack(of).triangles
    gbuffer = first_hit(triangles, pose, FOV, side, side)
    return gbuffer, channel(gbuffer, triangles.material, FOV, "albedo")


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_camera_sees_every_pixel_of_a_picture_on_two_triangles(mirrored: bool):
    item = scene(mirrored=mirrored)
    assert len(item.objects[0].mesh) == 2
    expected = 0.96 * linear(NOISE.repeat(2, 0).repeat(2, 1))
    wrong = np.abs(seen(item)[1] - (expected[:, ::-1] if mirrored else expected)).max(-1) > 0.02
    # parts are triangles, pixels are squares: some are seen beside each other's edges
    assert wrong.mean() < 0.35
    flat = np.abs(0.96 * linear(NOISE).mean((0, 1)) - expected).max(-1) > 0.02
    assert flat.mean() > 0.95


def test_from_afar_a_picture_is_its_mean():
    # a pixel sees 36 of the picture's
    far = look_at((0, 0, 6), up=(0, 1, 0))
    gbuffer, albedo = seen(scene(), far, side=48)
    assert gbuffer.hit.sum() >= 40
    spread = albedo[gbuffer.hit].std(axis=0)
    assert (spread < 0.1).all() and (linear(NOISE).std(axis=(0, 1)) > 0.28).all()
    np.testing.assert_allclose(albedo[gbuffer.hit].mean(axis=0), 0.96 * linear(NOISE).mean((0, 1)), rtol=0.05)


def test_light_on_a_picture_is_reflected_by_its_pixels():
    packed = replace(pack(scene(COARSE)), c2w=ABOVE[None].astype(np.float32), fov=np.array([FOV], np.float32))
    radiance = Renderer.load("radiosity").render(packed, resolution=SIDE)[0]
    albedo, inner = seen(scene(COARSE))[1], slice(8, -8)
    assert np.corrcoef(radiance[inner, inner].ravel(), albedo[inner, inner].ravel())[0, 1] > 0.9


def test_a_normal_map_tilts_the_normals_that_a_camera_sees():
    tilted = np.broadcast_to(np.round(np.array([0.6, 0.0, 0.8]) * 127.5 + 127.5), (8, 8, 3)).copy()
    tilted[:, 4:] = np.round(np.array([0.0, 0.6, 0.8]) * 127.5 + 127.5)
    gbuffer, _ = seen(scene(None, tilted))
    left, right = gbuffer.normal[:, 8:40].reshape(-1, 3), gbuffer.normal[:, 56:88].reshape(-1, 3)
    # red points to the right of the picture, green to its top
    np.testing.assert_allclose(np.median(left, axis=0), [0.6, 0, 0.8], atol=0.02)
    np.testing.assert_allclose(np.median(right, axis=0), [0, 0.6, 0.8], atol=0.02)


def test_what_has_no_normal_map_keeps_its_normals():
    np.testing.assert_allclose(seen(scene())[0].normal.reshape(-1, 3), [[0, 0, 1]] * SIDE**2, atol=1e-6)


def test_a_mirror_shows_a_picture_in_full():
    picture, *lamp = scene(COARSE).objects
    corners = [[-0.6, 0.6, 0], [0.6, 0.6, 0], [0.6, 0.6, 1], [-0.6, 0.6, 1]]
    mirror = SceneObject(
        name="mirror",
        mesh=Mesh(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]])),
        material=Material(diffuse=(0, 0, 0), specular=(1, 1, 1), roughness=0.0),
    )
    behind = np.diag([1, -1, 1, 1.0])
    behind[1, 3] = 1.2  # where the mirror shows the camera
    pose = look_at((0, 0, 0.5), (0, 0.6, 0.25))

    def lit(objects: list[SceneObject], pose: np.ndarray, textured=True) -> tuple[GBuffer, np.ndarray]:
        triangles = pack(Scene(objects=objects)).triangles
        triangles = triangles if textured else replace(triangles, texels=None)
        gbuffer = first_hit(triangles, pose, 60.0, SIDE, SIDE)
        lights = with_known_light(gbuffer, pose, 60.0, LightSampler(triangles), 16)
        return lights, direct_radiance(lights, triangles.material)

    expected, radiance = lit([picture, *lamp], behind @ pose)
    shares = []
    for textured in (True, False):
        shown, _ = lit([mirror, picture, *lamp], pose, textured)
        alike = np.abs(shown.reflection.light - radiance).max(-1) < 0.1 * radiance.max()
        shares.append(alike[(shown.triangle < 2) & shown.hit & expected.hit].mean())
    assert shares[0] > 0.8 and shares[1] < 0.4


def test_a_changed_material_covers_the_picture():
    item = scene()
    floor = item.objects[0]
    painted = floor.model_copy(update={"material": Material(diffuse=(0.5,) * 3, specular=(0,) * 3, roughness=1.0),
                                       "face_material": None})  # fmt: skip
    np.testing.assert_allclose(seen(Scene(objects=(painted, *item.objects[1:])))[1], 0.5, atol=1e-6)
    assert MaterialTensors.of(pack(item), {}, torch.device("cpu")).scene.triangles.texels is None


def test_texture_coordinates_without_bounds_are_refused(tmp_path: Path):
    builder = GltfBuilder()
    texture = builder.texture(NOISE)
    texture["extensions"] = {"KHR_texture_transform": {"scale": [1e308, -1e308]}}
    uv = {"TEXCOORD_0": builder.accessor(SQUARE_UV * 1e30)}
    builder.node(builder.primitive(material={"pbrMetallicRoughness": {"baseColorTexture": texture}}, attributes=uv))
    with pytest.raises(SceneError, match="baseColorTexture: its texture coordinates are too large"):
        load_scene(builder.write(tmp_path))


def test_fine_pictures_fit_into_the_budget():
    rng = np.random.default_rng(0)
    texels = pack(scene(rng.integers(0, 256, (1100, 1100, 3)))).triangles.texels
    assert 2**18 < len(texels.values) < 1.4 * 2**20
