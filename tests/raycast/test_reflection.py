"""Reflections against mirrored cameras, and against Cycles' own indirect pass."""

from pathlib import Path

import numpy as np
import pytest
from known_scenes import LIGHT, box, look_at, material, pack, sphere, square
from marks import requires_blender
from reference_presets import preset

from rfpp.raycast.direct_light import direct_radiance
from rfpp.raycast.first_hit import GBuffer, Reflection, channel, first_hit, stack_channels
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.reference.cycles import CyclesSettings, render_passes
from rfpp.scene.camera import camera_to_world
from rfpp.scene.io.loading import load_scene
from rfpp.scene.triangles import SceneTriangles

ROOT = Path(__file__).parents[2]
POSE = look_at((0.3, -1.5, 0.9), (0, 0, 0.1))
LAMP = (LIGHT * 2.5 + [0.5, -0.5, 2.0], material(1.0, emission=2500.0))
THINGS = (
    (box(0.2, (0.2, 0.1, 0.3)), material(diffuse=(0.7, 0.2, 0.1))),
    (sphere(0.15, (-0.2, 0, 0.25)), material(diffuse=(0.1, 0.3, 0.6), specular=0.2, roughness=0.5)),
)


def reflecting(scene: SceneTriangles, pose=POSE, samples=8, size=32, fov=40.0, seed=0) -> GBuffer:
    return with_known_light(first_hit(scene, pose, fov, size, size), pose, fov, LightSampler(scene), samples, seed)


def reflection(*args, **kwargs) -> Reflection:
    return reflecting(*args, **kwargs).reflection


def test_a_mirror_shows_what_a_mirrored_camera_sees():
    mirror = (square(4), material(specular=0.9, roughness=0.0))
    shown = reflecting(pack(mirror, *THINGS, LAMP), samples=1)
    on_floor = shown.hit & (shown.triangle < 2)

    behind = np.diag([1, 1, -1, 1.0]) @ POSE  # an improper pose, whose rays are those that the mirror sends up
    without = pack(*THINGS, LAMP)
    seen = first_hit(without, behind, 40.0, 32, 32)
    expected = with_known_light(seen, behind, 40.0, LightSampler(without), 64)
    radiance = direct_radiance(expected, without.material)
    assert 0.02 < seen.hit[on_floor].mean() < 0.9
    ours = shown.reflection.light
    alike = on_floor & (np.abs(ours - radiance).max(-1) < 0.02 * radiance.max())
    assert alike.sum() > 0.97 * on_floor.sum()  # all but edges and highlights, which the lobe's width moves
    assert ours[alike].mean() == pytest.approx(radiance[alike].mean(), rel=0.03)


def test_what_does_not_shine_reflects_nothing():
    none = reflection(pack((square(4), material(diffuse=0.8)), *THINGS[:1], LAMP))
    assert not none.light.any()


def test_an_emitter_in_the_mirror_is_direct_light():
    lamp = (square(2.0, z=2.0), material(1.0, emission=3.0))
    mirror = (square(2), material(specular=0.8, roughness=0.1))
    alone = reflection(pack(mirror, lamp), look_at((0.0, -0.1, 0.5), up=(0, 1, 0)), fov=10.0)
    assert not alone.light.any()


@pytest.mark.parametrize("roughness", [0.1, 0.4, 1.0])
def test_more_samples_find_the_same_reflection(roughness):
    dull = (sphere(0.3, (0, 0, 0.35)), material(diffuse=(0.1, 0.3, 0.6)))  # highlights in mirrors are too rare to count
    scene = pack((square(4), material(0.1, specular=0.7, roughness=roughness)), dull, LAMP)
    few = np.stack([reflection(scene, samples=8, size=8, seed=seed).light for seed in range(600)])
    many = reflection(scene, samples=3000, size=8).light
    standard_error = few.std(0) / len(few) ** 0.5
    assert (np.abs(few.mean(0) - many) < 5 * standard_error + 0.02 * many.max()).all()
    of_mean = few.mean((1, 2, 3)).std() / len(few) ** 0.5
    assert abs(few.mean() - many.mean()) < 3 * of_mean + 0.02 * many.mean()


def test_the_seed_decides():
    scene = pack((square(4), material(specular=0.9, roughness=0.5)), *THINGS, LAMP)
    first, again, other = reflection(scene), reflection(scene), reflection(scene, seed=1)
    np.testing.assert_array_equal(first.light, again.light)
    assert not np.array_equal(first.light, other.light)


def test_channels_carry_the_reflection():
    scene = pack((square(4), material(specular=0.9, roughness=0.2)), *THINGS, LAMP)
    gbuffer = reflecting(scene)
    stacked = stack_channels(gbuffer, scene.material, 40.0, ["roughness", "reflected_light"])
    np.testing.assert_array_equal(stacked[1:], gbuffer.reflection.light.transpose(2, 0, 1))
    with pytest.raises(ValueError, match="with reflections"):
        stack_channels(first_hit(scene, POSE, 40.0, 8, 8), scene.material, 40.0, ["reflected_light"])


@requires_blender
@pytest.mark.parametrize("name", ["mirror", "many_objects_table", "roughness_spheres", "cornell_box"])
def test_agrees_with_the_first_of_cycles_indirect_bounces(in_process, name):
    if name == "mirror":
        scene, pose, fov = pack((square(4), material(0.1, specular=0.8, roughness=0.2)), *THINGS, LAMP), POSE, 40.0
    else:
        described = load_scene(ROOT / "data" / "scenes" / f"{name}.json")
        scene, camera = SceneTriangles.from_scene(described), described.cameras[0]
        pose, fov = camera_to_world(camera), float(camera.fov)
    exact = {
        "samples": 2048, "denoise": False, "adaptive_threshold": 0.0, "light_threshold": 0.0, "max_bounces": 1,
        "diffuse_bounces": 1, "glossy_bounces": 1, "clamp_direct": 0.0, "clamp_indirect": 0.0, "caustics": True,
        "filter_width": 0.01, "threads": 1,
    }  # fmt: skip
    settings = preset("preview") | exact
    one_view = (pose[None].astype(np.float32), np.array([fov], np.float32))
    names = ["glossy_indirect", "glossy_color"]
    cycles = in_process(render_passes, scene, *one_view, 40, 40, CyclesSettings(**settings), names)
    expected = (cycles["glossy_indirect"] * cycles["glossy_color"])[0]
    gbuffer = reflecting(scene, pose, samples=8192, size=40, fov=fov)
    ours = channel(gbuffer, scene.material, fov, "specular") * gbuffer.reflection.light
    ours, expected = np.minimum(ours, 1), np.minimum(expected, 1)  # single pixels see a lamp in two mirrors
    assert np.abs(ours - expected).mean() / expected.mean() < 0.12  # a third of it is the noise of either
    assert ours.mean() == pytest.approx(expected.mean(), rel=0.07)
