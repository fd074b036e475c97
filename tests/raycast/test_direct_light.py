"""Direct light against closed forms, numeric integration, and Cycles' own direct passes."""

from pathlib import Path

import numpy as np
import pytest
from known_scenes import LIGHT, box, look_at, material, moved, pack, rigid_motion, sphere, square, still_life
from marks import requires_blender
from reference_presets import preset
from scene_families import draw, family
from slow_light import direct_light, form_factor

from rfpp.raycast import light_sampler, surface, threads
from rfpp.raycast.first_hit import DirectLight, GBuffer, channel, first_hit, stack_channels
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.polygon_light import SCRATCH_ROWS, unoccluded_each
from rfpp.reference.cycles import CyclesSettings, render_passes
from rfpp.scene.camera import camera_to_world
from rfpp.scene.io.loading import load_scene
from rfpp.scene.triangles import EMISSION, SceneTriangles

ROOT = Path(__file__).parents[2]
POSE = look_at((0.3, -1.5, 0.9), (0, 0, 0.1))


def lit(scene: SceneTriangles, pose=POSE, samples=8, size=32, fov=40.0, seed=0) -> GBuffer:
    return with_known_light(first_hit(scene, pose, fov, size, size), pose, fov, LightSampler(scene), samples, seed)


def light(*args, **kwargs) -> DirectLight:
    return lit(*args, **kwargs).light


def relative_error(image, truth) -> float:
    return float(np.abs(image - truth).mean() / truth.mean())


def test_a_small_triangle_far_away_is_a_point_light():
    corners = 0.01 * np.array([[[0, 0, 0], [1, 0, 0.3], [0, 1, -0.2]]]) + [0.3, -0.4, 2.0]
    cross = np.cross(corners[0, 1] - corners[0, 0], corners[0, 2] - corners[0, 0])
    direction = corners[0].mean(0)
    distance = np.linalg.norm(direction)
    expected = (
        np.linalg.norm(cross) / 2 * abs(cross @ direction) / np.linalg.norm(cross) * direction[2] / distance**4 / np.pi
    )
    got = form_factor(np.zeros(3), np.array([0, 0, 1.0]), corners)
    assert got[0] == pytest.approx(expected, rel=1e-3)


def test_light_all_around_a_point_gives_one_whatever_the_normal():
    shell = sphere(2.0, subdivisions=2)
    normals = np.random.default_rng(0).normal(size=(20, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (20, 3))
    np.testing.assert_allclose(form_factor(points[:, None], normals[:, None], shell).sum(1), 1, rtol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_triangles_cut_by_the_horizon_match_numeric_integration(seed):
    rng = np.random.default_rng(seed)
    corners = rng.uniform((-0.6, -0.1, -1), (1.4, 1.9, 1), (1, 3, 3))
    normal = np.array([[0, 0, 1.0]])
    assert (corners[0, :, 2] > 0).any() and (corners[0, :, 2] < 0).any()
    side = (np.arange(700) + 0.5) / 700
    u, v = (a.ravel() for a in np.meshgrid(side, side))
    root = np.sqrt(u)[:, None]
    a, b, c = corners[0]
    points = (1 - root) * a + root * (1 - v[:, None]) * b + root * v[:, None] * c
    cross = np.cross(b - a, c - a)
    distance2 = (points**2).sum(-1)
    expected = (np.abs(points @ cross) / 2 * points[:, 2].clip(0) / distance2**2).mean() / np.pi
    assert form_factor(np.zeros(3), normal[0], corners)[0] == pytest.approx(expected, rel=5e-3, abs=1e-6)


def test_an_open_floor_carries_no_noise_and_a_roof_makes_it_dark():
    lamp = (LIGHT * 2.5 + [0, 0, 2.0], material(1.0, emission=1000.0))
    floor = (square(40), material(0.5, specular=0.3))
    open_floor = light(pack(floor, lamp), samples=1)
    np.testing.assert_array_equal(open_floor.diffuse, light(pack(floor, lamp), samples=1, seed=5).diffuse)
    seen = first_hit(pack(floor, lamp), POSE, 40.0, 32, 32).hit
    assert (open_floor.diffuse[seen] > 0).all() and not open_floor.diffuse[~seen].any()
    roofed = light(pack(floor, lamp, (square(40, z=1.5), material(0.5))))
    assert not roofed.diffuse.any() and not roofed.glossy.any()


def test_half_a_light_behind_a_wall_gives_its_half():
    lamp = (square(0.4, z=2.0), material(1.0, emission=10.0))
    floor = (square(4), material(0.5))
    wall = (square(20, z=1.0) + np.array([10, 0, 0]), material(0.0))  # covers x > 0
    pose = look_at((0.0, 0.0, 0.9), up=(0, 1, 0))
    whole, half = (light(pack(floor, lamp, *w), pose, samples=256, size=1, fov=1.0).diffuse for w in ((), (wall,)))
    np.testing.assert_allclose(half, whole / 2, rtol=0.02)


def test_a_mirror_shows_the_light_at_its_radiance():
    lamp = (square(2.0, z=2.0), material(1.0, emission=(3.0, 2.0, 1.0)))
    mirror = (square(2), material(0.0, specular=0.8, roughness=0.1))
    glossy = light(pack(mirror, lamp), look_at((0.0, -0.1, 0.5), up=(0, 1, 0)), fov=10.0).glossy
    np.testing.assert_allclose(glossy.mean((0, 1)), [3.0, 2.0, 1.0], rtol=0.01)
    np.testing.assert_allclose(glossy, np.broadcast_to([3.0, 2.0, 1.0], glossy.shape), rtol=0.25)


@pytest.mark.parametrize("roughness", [0.1, 0.4, 1.0])
def test_more_samples_find_the_same_light(roughness):
    floor = (square(), material(0.2, specular=0.7, roughness=roughness))
    scene = pack(floor, (square(0.5) + np.array([0.2, 0.3, 0.6]), material(1.0, emission=5.0)))
    few = np.stack([light(scene, samples=2, size=8, seed=seed).glossy for seed in range(200)])
    many = np.mean([light(scene, samples=200, size=8, seed=seed).glossy for seed in range(50)], axis=0)
    standard_error = few.std(0) / len(few) ** 0.5
    assert (np.abs(few.mean(0) - many) < 5 * standard_error + 0.005 * many.max()).all()
    assert few.mean() == pytest.approx(many.mean(), rel=0.02)


#: Lamps of few triangles: solid ones, wound either way, and a roof of two sides.
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])[[[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]]
ROOF = np.array([[[-1, -1, 0], [1, -1, 0], [0, 0, 1]], [[-1, 1, 0], [0, 0, 1], [1, 1, 0.0]]])
LAMPS = {
    "tetrahedron": 0.1 * TETRAHEDRON + [0.2, 0.1, 1.0],
    "inside out": 0.1 * TETRAHEDRON[:, ::-1] + [0.2, 0.1, 1.0],
    "roof": 0.2 * ROOF + [0.2, 0.1, 0.8],
}


@pytest.mark.parametrize("lamp", LAMPS)
@pytest.mark.parametrize("roughness", [0.4, 0.6])
def test_the_sides_of_a_lamp_that_hide_each_other_send_what_they_should(lamp, roughness):
    floor = (square(2), material(0.5, specular=0.4, roughness=roughness))
    scene = pack(floor, (LAMPS[lamp], material(1.0, emission=20.0)))
    few, many = (lit(scene, samples=samples, size=24) for samples in (1, 64))
    points = surface.Surface.at_hits(many, scene, POSE, 40.0)
    truth = direct_light(scene, points, 400, np.random.default_rng(0))
    for number, most in enumerate((0.03, 0.06)):  # of the noise of both in single pixels
        found, of_one_sample = ((seen.light.diffuse, seen.light.glossy)[number][seen.hit] for seen in (many, few))
        assert relative_error(found, truth[number]) < most
        assert found.mean() == pytest.approx(truth[number].mean(), rel=0.02)
        assert of_one_sample.mean() == pytest.approx(truth[number].mean(), rel=0.1)


def test_a_lamp_around_the_scene_is_no_solid():
    room = (30.0 * TETRAHEDRON, material(1.0, emission=20.0))
    assert not LightSampler(pack((square(2), material(0.5)), room)).scene.solid.any()


@pytest.mark.parametrize("lamp", [TETRAHEDRON, TETRAHEDRON[:, ::-1], square(1.0)], ids=["solid", "inside out", "flat"])
def test_light_at_many_points_at_once_is_that_at_each(lamp):
    rng = np.random.default_rng(0)
    radiance = (3.0, 2.0, 1.0)
    scene = LightSampler(pack((square(2, z=-9.0), material(0.5)), (lamp, material(1.0, emission=radiance)))).scene
    points, normals = rng.uniform(-4, 4, (2000, 3)), rng.normal(size=(2000, 3))
    points, normals = points[(np.abs(points) > 1).any(-1)], normals[(np.abs(points) > 1).any(-1)]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    above = (np.einsum("rk,ecrk->rec", normals, scene.corners[:, :, None] - points) > 0).reshape(len(points), -1)
    assert (above.any(1) & ~above.all(1)).mean() > 0.1  # horizons that cut the lamp
    shines = ((scene.corners[:, 0] - points[:, None]) * scene.facing).sum(-1) < 0 if scene.solid[0] else True
    expected = (form_factor(points[:, None], normals[:, None], scene.corners) * shines).sum(1)
    found = np.full((SCRATCH_ROWS, len(points)), np.nan)
    for start, stop in ((0, 7), (7, 1200), (1200, len(points))):
        unoccluded_each(start, stop, scene, 0, points, normals, start, found)
    np.testing.assert_allclose(found[:3], np.outer(radiance, expected), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("roughness", [0.15, 0.3, 0.5])
def test_highlights_that_ask_for_few_samples_are_as_bright_as_others(roughness):
    """Sharp lobes near the lamp's mirror image and far from it, of a lamp that a point of them sees as a small one."""
    floor = (square(4), material(0.2, specular=0.7, roughness=roughness))
    scene = pack(floor, (square(0.1) + np.array([0.2, 0.9, 0.6]), material(1.0, emission=50.0)))
    probed, full = (
        np.stack([light(scene, samples=samples, size=12, seed=seed).glossy.mean(-1) for seed in range(150)])
        for samples in (8, 64)
    )
    standard_error = np.sqrt((probed.var(0) + full.var(0)) / len(full))
    assert (np.abs(probed.mean(0) - full.mean(0)) < 5 * standard_error + 1e-3 * full.max()).all()
    error = np.sqrt((probed.mean((1, 2)).var() + full.mean((1, 2)).var()) / len(full))
    assert abs(probed.mean() - full.mean()) < 4 * error < 0.1 * full.mean()


def test_an_emissive_mesh_is_one_light_in_every_way():
    lamp, floor = sphere(0.2, (0.3, 0.2, 0.9), subdivisions=2), (square(), material(0.5, specular=0.4, roughness=0.4))
    glowing = material(1.0, emission=20.0)
    together = pack(floor, (lamp, glowing))
    apart = pack(floor, *((triangle[None], glowing) for triangle in lamp))
    assert len(LightSampler(together).names) == 1
    assert len(LightSampler(apart).names) == len(lamp)
    one, many = light(together, samples=1024, size=8), light(apart, samples=16, size=8)
    np.testing.assert_allclose(one.glossy, many.glossy, rtol=0.1, atol=0.02 * many.glossy.max())
    # the far side of a sphere is hidden by the near one, which shadow rays must find
    np.testing.assert_allclose(one.diffuse, many.diffuse, rtol=0.05)


def test_lights_add_up():
    scene = still_life()
    parts = []
    for kept in ((3, 4), (3,), (4,)):
        emission = scene.material.copy()
        dark = scene.is_emissive & ~np.isin(scene.object_index, kept)
        emission[dark, EMISSION] = 1e-30  # still a light, so still unseen by the camera
        parts.append(light(SceneTriangles(**{**vars(scene), "material": emission}), samples=64))
    np.testing.assert_allclose(parts[0].diffuse, parts[1].diffuse + parts[2].diffuse, rtol=1e-4, atol=1e-4)


def test_neighbors_among_many_lights_are_sampled_together(monkeypatch):
    places = np.random.default_rng(5).uniform((-1, -1, 0.6), (1, 1, 1.2), (300, 3))
    floor, glowing = (square(), material(0.5, specular=0.3, roughness=0.4)), material(1.0, emission=20.0)
    scene = pack(floor, (box(0.2, (0.1, 0.1, 0.1)), material(0.6)), *((LIGHT + place, glowing) for place in places))
    pose, fov, sampler = POSE, 40.0, LightSampler(scene)
    assert len(sampler.scene.shining) == 128
    together = light(scene, samples=16)
    monkeypatch.setattr(light_sampler, "_AT_MOST", 300)
    apart = light(scene, samples=16)
    assert relative_error(together.diffuse, apart.diffuse) < 0.02
    assert together.diffuse.mean() == pytest.approx(apart.diffuse.mean(), rel=2e-3)
    assert together.glossy.mean() == pytest.approx(apart.glossy.mean(), rel=1e-2)
    hits = first_hit(scene, pose, fov, 16, 16)
    one, two, both = (
        with_known_light(hits, pose, fov, chosen, samples=256).light.diffuse.mean()
        for chosen in (sampler.only("object_2"), LightSampler(scene).only("object_2"), sampler)
    )
    assert one == pytest.approx(two, rel=0.1)
    assert one < both / 30


def test_rigid_motion_of_scene_and_camera_changes_nothing():
    scene, motion = still_life(), rigid_motion()
    here, there = lit(scene), lit(moved(scene, motion), (motion @ POSE).astype(np.float32))
    same = here.triangle == there.triangle
    error = np.abs(here.light.diffuse - there.light.diffuse)[same]
    assert np.median(error) < 1e-4 * here.light.diffuse.max()
    assert relative_error(there.light.diffuse[same], here.light.diffuse[same]) < 0.01


def test_the_seed_decides_and_the_number_of_threads_does_not(monkeypatch):
    scene = still_life()
    first, again, other = light(scene), light(scene), light(scene, seed=1)
    np.testing.assert_array_equal(first.glossy, again.glossy)
    assert not np.array_equal(first.glossy, other.glossy)
    monkeypatch.setattr(threads, "_FEW", 100)
    monkeypatch.setattr(threads, "cores", lambda: 7)
    np.testing.assert_array_equal(light(scene).glossy, first.glossy)
    np.testing.assert_array_equal(light(scene).diffuse, first.diffuse)


def test_a_scene_without_light_is_dark_and_channels_carry_the_light():
    scene = still_life()
    dark = SceneTriangles(**{**vars(scene), "material": scene.material * ([1] * 7 + [0] * 3)})
    assert not light(dark).diffuse.any() and not light(dark).glossy.any()
    gbuffer = lit(scene)
    stacked = stack_channels(gbuffer, scene.material, 40.0, ["direct_glossy", "direct_diffuse"])
    np.testing.assert_array_equal(stacked[3:], gbuffer.light.diffuse.transpose(2, 0, 1))
    with pytest.raises(ValueError, match="with direct light"):
        stack_channels(first_hit(scene, POSE, 40.0, 8, 8), scene.material, 40.0, ["direct_diffuse"])


@requires_blender
@pytest.mark.parametrize("name", ["still life", "drawn", "cornell_box", "many_objects_table", "roughness_spheres"])
def test_agrees_with_cycles_direct_passes(in_process, name):
    if name == "still life":
        scene, pose, fov = still_life(), POSE, 40.0
    else:
        stored = ROOT / "data" / "scenes" / f"{name}.json"
        described = draw(family("large_scale"), 1, 2) if name == "drawn" else load_scene(stored)
        scene, camera = SceneTriangles.from_scene(described), described.cameras[0]
        pose, fov = camera_to_world(camera), float(camera.fov)
    exact = {"samples": 256, "denoise": False, "adaptive_threshold": 0.0, "light_threshold": 0.0, "max_bounces": 0}
    settings = preset("preview") | exact | {"filter_width": 0.01, "threads": 1}
    names = ["diffuse_direct", "diffuse_color", "glossy_direct", "glossy_color"]
    one_view = (pose[None].astype(np.float32), np.array([fov], np.float32))
    cycles = in_process(render_passes, scene, *one_view, 48, 48, CyclesSettings(**settings), names)
    gbuffer = lit(scene, pose, samples=64, size=48, fov=fov)
    for lobe, reflectance, tolerance in (("diffuse", "albedo", 0.02), ("glossy", "specular", 0.05)):
        ours = channel(gbuffer, scene.material, fov, reflectance) * getattr(gbuffer.light, lobe)
        assert relative_error(ours, (cycles[f"{lobe}_direct"] * cycles[f"{lobe}_color"])[0]) < tolerance


def test_an_eye_on_the_surface_itself_looks_along_its_normal():
    """As with a camera that stands in a wall: a direction of NaN came as far as a table, as an index."""
    scene = still_life()
    point = scene.positions[:1].mean(axis=1).astype(np.float64)
    normal = scene.normals[:1, 0].astype(np.float64)
    on_it = surface.Surface.at(scene, np.zeros(1, int), point, normal, point[0])
    np.testing.assert_array_equal(on_it.view, normal)
    assert np.isfinite(on_it.point).all()
