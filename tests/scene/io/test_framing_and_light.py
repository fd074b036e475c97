"""Where imported scenes stand, what sees them, and that they are lit as brightly as their files say."""

import warnings
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from known_scenes import look_at, material, pack
from scipy.spatial import ConvexHull

from rfpp.errors import SceneError
from rfpp.raycast.first_hit import first_hit
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.surface import Surface
from rfpp.scene.io.framing import Framing, default_camera
from rfpp.scene.io.imported_scene import ImportedScene, Part, PunctualLight, plain_material
from rfpp.scene.io.light_rig import USUAL, irradiance, with_lights
from rfpp.scene.io.loading import load_scene
from rfpp.scene.io.punctual_lights import fixture, separate
from rfpp.scene.packed import pack as packed
from rfpp.scene.spec import Camera
from rfpp.scene.triangles import EMISSION, SceneTriangles

EXAMPLES = Path(__file__).parents[3] / "data" / "scenes"
FILE = Path("a.glb")
CAMERA = Camera(position=(0, -2, 0), look_at=(0, 0, 0), fov=40)
FLOOR = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])


def part(vertices=FLOOR, emission: float = 0.0, name: str = "part") -> Part:
    faces = np.array([[0, 1, 2], [0, 2, 3]])[: len(vertices) - 2]
    rows = plain_material(len(faces))
    rows[:, EMISSION] = emission
    return Part(name, np.array(vertices, np.float64), faces, rows, smooth=False)


def lamp(
    kind: str = "point", position=(0, 0, 1), direction=(0, 0, -1), strength: float = 1.0, cone=(0.0, np.pi / 4)
) -> PunctualLight:
    strengths, place, towards = np.full(3, strength), np.array(position, float), np.array(direction, float)
    return PunctualLight("lamp", kind, strengths, place, towards, cone)


def quietly(function, *args):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return function(*args)


def test_surfaces_fill_the_box_and_everything_moves_with_them() -> None:
    camera = Camera(position=(100, 0, 0), look_at=(100, 50, 0), fov=40)
    far = part(FLOOR * (20, 10, 1) + (100, 50, 7))
    bulb = part(np.add(FLOOR, (100, 50, 900)), emission=3.0)
    before = ImportedScene("a", (far, bulb), (lamp(position=(100, 50, 27)), lamp("directional")), (camera,))
    after = Framing.of(before.parts).scene(before)
    np.testing.assert_allclose(after.parts[0].vertices, FLOOR * (1, 0.5, 1), atol=1e-12)
    np.testing.assert_allclose(after.parts[1].vertices.mean(axis=0), [0, 0, 893 * 0.05])  # lights may stand outside
    assert after.parts[1].material[0, EMISSION][0] == 3  # radiance stays
    np.testing.assert_allclose(after.punctual_lights[0].position, [0, 0, 1])
    np.testing.assert_allclose([light.strength[0] for light in after.punctual_lights], [0.05**2, 1])
    np.testing.assert_allclose(after.cameras[0].position, [0, -2.5, -0.35])
    np.testing.assert_allclose(np.subtract(after.cameras[0].look_at, after.cameras[0].position), [0, 1, 0])


@pytest.mark.parametrize(("vertices", "stays"), [(FLOOR, True), (FLOOR * 0.6, True), (FLOOR * 0.4, False),
                                                 (FLOOR + 0.1, False)])  # fmt: skip
def test_scenes_made_for_the_box_stay_as_they_are(vertices: np.ndarray, stays: bool) -> None:
    scene = ImportedScene("a", (part(vertices),))
    assert (Framing.of(scene.parts).scene(scene) is scene) == stays


def test_what_has_no_extent_or_is_invisible_is_refused() -> None:
    with pytest.raises(SceneError, match="no extent"):
        Framing.of((part(FLOOR * 0),))
    with pytest.raises(SceneError, match="no visible surface"):
        Framing.of((part(emission=1.0),))


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 0.1), (0.1, 0.1, 1), (1, 0.2, 0.2)])
def test_the_default_camera_sees_the_whole_scene_and_little_else(shape: tuple) -> None:
    corners = (np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 3) * shape)[[0, 1, 6, 7]]
    camera = default_camera([part(corners)])
    pose = look_at(camera.position, camera.look_at).astype(float)
    seen = (corners - pose[:3, 3]) @ pose[:3, :3]
    reach = np.abs(seen[:, :2] / seen[:, 2:]).max() / np.tan(np.radians(camera.fov) / 2)
    assert 0.5 < reach <= 1 + 1e-6
    assert 30 <= camera.fov <= 60
    assert camera.position[1] < 0 < camera.position[2]


def seen_from_above(triangles: SceneTriangles, width: int = 17, samples: int = 4):
    """Return the points and the irradiance, shadows included, that the ray caster finds on what a camera above sees."""
    pose, fov = look_at((0, 0, 1.2), up=(0, 1, 0)), 30.0
    sampler = LightSampler(triangles)
    hits = with_known_light(first_hit(triangles, pose, fov, width, width), pose, fov, sampler, samples)
    return Surface.at_hits(hits, triangles, pose, fov).point, np.pi * hits.light.diffuse[hits.hit].mean(axis=-1)


def cast(triangles: SceneTriangles) -> float:
    return float(seen_from_above(triangles)[1].mean())


def below(light: PunctualLight, floor: np.ndarray) -> SceneTriangles:
    surfaces = [(item.corners, item.material[0]) for item in fixture(light)]
    return pack((part(floor).corners, material(diffuse=0.5)), *surfaces)


@pytest.mark.parametrize("kind", ["point", "spot", "directional"])
def test_a_lamp_gives_the_irradiance_it_promises(kind: str) -> None:
    """On a small floor below: intensity over squared distance, or the irradiance of the sun."""
    light = lamp(kind, position=(0, 0, 1.5), strength=2.0, cone=(0.05, 0.1))
    expected = 2.0 if kind == "directional" else 2.0 / 1.5**2
    assert cast(below(light, FLOOR * 0.02)) == pytest.approx(expected, rel=0.05 if kind == "point" else 0.01)


@pytest.mark.parametrize("cone", [(0.0, 0.25), (0.1, 0.2), (0.2, 0.2)])
def test_a_spot_lights_its_cone_and_nothing_else(cone: tuple[float, float]) -> None:
    light, place = lamp("spot", position=(0, 0, 1.5), strength=2.0, cone=cone), np.array((0, 0, 1.5))
    points, irradiance_of = seen_from_above(below(light, FLOOR), width=48, samples=64)
    towards = points - place
    distance = np.linalg.norm(towards, axis=-1)
    angle = np.arccos(-towards[:, 2] / distance)
    assert (irradiance_of[angle > cone[1] + 0.03] == 0).all()
    share = np.clip((np.cos(angle) - np.cos(cone[1])) / max(np.cos(cone[0]) - np.cos(cone[1]), 1e-9), 0, 1)
    expected = 2.0 * 1.5 / distance**3 * share**2 * (3 - 2 * share)  # by smoothstep, as in Blender
    assert np.abs(irradiance_of - expected).mean() < 0.1 * expected.mean()
    assert irradiance_of.sum() == pytest.approx(expected.sum(), rel=0.02)


def test_a_point_light_is_even_in_all_directions() -> None:
    (bulb,) = fixture(lamp(position=(0, 0, 0), strength=2.0))
    towards = np.random.default_rng(0).normal(size=(500, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    a, b, c = np.moveaxis(bulb.corners, 1, 0)
    intensity = (np.cross(b - a, c - a) / 2 @ towards.T).clip(0).sum(0) * bulb.material[0, EMISSION][0]
    np.testing.assert_allclose(intensity, 2.0, rtol=0.05)
    assert intensity.mean() == pytest.approx(2.0, rel=0.01)


def test_point_lights_that_touch_are_one() -> None:
    """At the strongest of them, and as bright together; others stay, however near."""
    lights = [lamp(position=(x, 0, 1), strength=strength) for x, strength in ((0, 1), (0.03, 3), (0.06, 1), (0.08, 1))]
    kept = separate([*lights, lamp("spot", position=(0.03, 0, 1)), lamp("directional")])
    assert [(light.kind, light.position[0], light.strength[0]) for light in kept] == [
        ("spot", 0.03, 1), ("directional", 0, 1), ("point", 0.03, 5), ("point", 0.08, 1)
    ]  # fmt: skip
    assert len(separate([lamp()] * 20_000)) == 1
    assert separate([]) == []


def test_a_sun_is_even_in_the_whole_box() -> None:
    for height in (-0.5, 0.5):
        moved = [(item.corners - (0, 0, height), item.material[0]) for item in fixture(lamp("directional"))]
        floor = (part(FLOOR * (1, 1, 0)).corners, material(diffuse=0.5))
        irradiance_of = seen_from_above(pack(floor, *moved))[1]
        np.testing.assert_allclose(irradiance_of, 1, rtol=0.05)


def parts_of(triangles: SceneTriangles) -> list[Part]:
    return [
        Part(f"{a}", triangles.positions[a:b].reshape(-1, 3).astype(np.float64),
             np.arange(3 * (b - a)).reshape(-1, 3), triangles.material[a:b], smooth=False)
        for a, b in pairwise(triangles.object_offsets)
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["cornell_box", "roughness_spheres", "many_objects_table"])
def test_usual_is_what_the_examples_have(name: str) -> None:
    triangles = packed(load_scene(EXAMPLES / f"{name}.json")).triangles
    assert USUAL / 1.3 < irradiance(parts_of(triangles)) < USUAL * 1.3


def test_the_estimated_irradiance_is_that_of_the_ray_caster() -> None:
    [light] = fixture(lamp("directional", direction=(0.6, 0, -0.8), strength=3.0))
    triangles = pack((part().corners, material(diffuse=0.5)), (light.corners, light.material[0]))
    assert irradiance(parts_of(triangles)) == pytest.approx(cast(triangles), rel=0.05)
    assert irradiance([part(), replace(light, faces=light.faces[:, ::-1])]) == 0  # it faces away, and has a dark back


def test_dark_scenes_get_three_lights() -> None:
    scene = ImportedScene("a", (part(),))
    with pytest.warns(UserWarning, match=r"a\.glb: it has no light: three lights are added"):
        parts = with_lights(scene, CAMERA, FILE)
    assert [p.name for p in parts] == ["part", "key_light", "fill_light", "back_light"]
    assert USUAL / 10 < irradiance(parts) < USUAL
    for light in parts[1:]:
        assert np.linalg.norm(light.vertices.mean(axis=0)) == pytest.approx(2.4)


def test_the_lights_that_are_added_burn_nothing_out() -> None:
    """Not even white, in the corner of the box that is nearest to them, and turned towards them."""
    lights, rng = quietly(with_lights, ImportedScene("a", (part(),)), CAMERA, FILE)[1:], np.random.default_rng(0)
    places = rng.uniform(-0.5, 0.5, (300, 3)).round()  # corners, centers of sides and of the box
    brightest = 0.0
    for place, normal in zip(places, rng.normal(size=(300, 3)), strict=True):
        aside = np.cross(normal, rng.normal(size=3))
        patch = part(place + 1e-3 * np.stack([aside, np.cross(normal, aside), -aside]))
        brightest = max(brightest, irradiance([patch, *lights]) / np.pi)
    assert 0.5 < brightest < 1


def test_a_glowing_decal_is_no_light_for_a_scene() -> None:
    decal = part(FLOOR[[0, 1, 2]] * 0.02 + (0, 0, 0.3), emission=1.0)
    with (
        pytest.warns(UserWarning, match=r"emissive parts light the scene and are invisible to the camera \(1\)"),
        pytest.warns(UserWarning, match=r"its brightness is 0\.\d% of training scenes': three lights are added"),
    ):
        assert len(with_lights(ImportedScene("a", (part(), decal)), CAMERA, FILE)) == 5


def test_dazzling_lights_are_dimmed_together() -> None:
    lamps = (lamp(strength=400.0), lamp(position=(0.2, 0, 1), strength=200.0))
    with pytest.warns(UserWarning, match=r"its lights are scaled by 0\.00\d+ to the brightness"):
        parts = with_lights(ImportedScene("a", (part(),), lamps), CAMERA, FILE)
    assert irradiance(parts) == pytest.approx(USUAL, rel=0.01)
    first, second = (p.material[0, EMISSION][0] for p in parts[1:])
    assert first == pytest.approx(2 * second, rel=1e-5)


@pytest.mark.parametrize("strength", [1.0, 10.0])
def test_ordinary_lights_are_left_alone(strength: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parts = with_lights(ImportedScene("a", (part(),), (lamp(strength=strength),)), CAMERA, FILE)
    np.testing.assert_allclose(parts[1].material, fixture(lamp(strength=strength))[0].material)


def test_the_shades_of_spots_are_announced() -> None:
    with pytest.warns(UserWarning, match=r"spot lights shine from black shades, which the camera can see \(1\)"):
        with_lights(ImportedScene("a", (part(),), (lamp("spot"), lamp("directional"))), CAMERA, FILE)


def test_lights_are_added_inside_a_closed_room() -> None:
    corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), -1).reshape(-1, 3)
    faces = ConvexHull(corners).simplices
    room = Part("room", corners, faces, plain_material(len(faces)), smooth=False)
    camera = Camera(position=(0.3, -0.45, 0.1), look_at=(0, 0, 0), fov=60)
    with pytest.warns(UserWarning, match="three lights are added, in front of what would block them"):
        lights = with_lights(ImportedScene("a", (room,)), camera, FILE)[1:]
    inside = part(FLOOR * 0.1)
    assert all(np.abs(light.vertices).max() < 0.5 for light in lights)
    alone = quietly(with_lights, ImportedScene("a", (inside,)), camera, FILE)[1:]
    assert irradiance([inside, *lights]) == pytest.approx(irradiance([inside, *alone]), rel=0.5)
