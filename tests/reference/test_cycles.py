"""Cycles against closed forms, against the G-buffer, and against itself."""

import dataclasses
import os
import resource
import signal
import tempfile

import numpy as np
import pytest
from camera_rays import pixel_rays
from known_scenes import LIGHT, box, look_at, material, moved, pack, rigid_motion, sphere, square, still_life
from marks import requires_blender
from reference_presets import preset

from rfpp.errors import SceneError, UserError
from rfpp.raycast.first_hit import first_hit, object_ids
from rfpp.reference.cycles import CyclesSettings, render, render_passes

pytestmark = requires_blender

QUICK = preset("preview")
RAW = {"denoise": False, "adaptive_threshold": 0.0, "clamp_indirect": 0.0, "threads": 1}


def settings(**changes) -> CyclesSettings:
    return CyclesSettings(**QUICK | {"threads": 1} | changes)


def one(value) -> np.ndarray:
    """A single view's pose or angle as a batch of one."""
    return np.asarray(value, np.float32)[None]


def relative_error(image, truth) -> float:
    return float(np.abs(image - truth).mean() / truth.mean())


def irradiance(points: np.ndarray, normal: np.ndarray, polygon: np.ndarray, radiance: float) -> np.ndarray:
    """Lambert's formula for the irradiance [P] at points with one normal from a uniform polygon [K, 3]."""
    corners = polygon - points[:, None]
    corners = corners / np.linalg.norm(corners, axis=-1, keepdims=True)
    following = np.roll(corners, -1, axis=1)
    axis = np.cross(corners, following)
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arccos(np.clip((corners * following).sum(-1), -1, 1))
    return radiance / 2 * np.abs((angle * (axis @ normal)).sum(-1))


def test_floor_under_the_light_matches_lamberts_formula(in_process):
    light, albedo = LIGHT[0] * 2.5 + [0, 0, 2.1], 0.8
    scene = pack((square(), material(albedo)), (light[None], material(1.0, emission=5000.0)))
    pose = look_at((0.2, -1, 1.2))
    image = in_process(render, scene, one(pose), one(30), 32, 32, settings(samples=64, **RAW))[0]
    origins, directions = pixel_rays(pose, 30.0, 32, 32)
    floor = (origins - directions * (origins[..., 2:] / directions[..., 2:])).reshape(-1, 3)
    expected = albedo / np.pi * irradiance(floor, np.array([0, 0, 1.0]), light, 5000.0).reshape(32, 32)
    inner = (np.abs(floor) < 0.45).all(-1).reshape(32, 32)
    assert inner.sum() > 500
    assert image[inner].mean() == pytest.approx(expected[inner].mean(), rel=0.01)
    np.testing.assert_allclose(image[inner].mean(-1), expected[inner], rtol=0.05)


@pytest.mark.parametrize(
    "surface",
    [material(diffuse=0.5), material(specular=1.0, roughness=0.6), material(diffuse=0.5, specular=0.5, roughness=0.05)],
    ids=["diffuse", "specular", "both"],
)
def test_furnace(in_process, surface):
    """A convex object inside a uniformly glowing room shows its albedo times the room's radiance."""
    scene = pack((sphere(0.3), surface), (box(4.0), material(emission=2.0)))
    pose = look_at((0, -1, 0.3))
    image = in_process(render, scene, one(pose), one(24), 24, 24, settings(samples=64, **RAW))[0]
    albedo = surface[0] + surface[3]
    assert first_hit(scene, pose, 24, 24, 24).hit.all()
    assert image.mean() == pytest.approx(2.0 * albedo, rel=0.02)


def test_colors_are_linear_and_in_rgb_order(in_process):
    albedo, radiance = np.array([0.8, 0.2, 0.05]), np.array([1.0, 2.0, 4.0])
    scene = pack((sphere(0.3), material(diffuse=albedo)), (box(4.0), material(emission=radiance)))
    image = in_process(render, scene, one(look_at((0, -1, 0))), one(24), 16, 16, settings(samples=64, **RAW))[0]
    np.testing.assert_allclose(image.mean((0, 1)), albedo * radiance, rtol=0.02)


def test_lights_are_invisible_and_the_world_is_black(in_process):
    lamp = sphere(0.2, (0, 0, 0.5))
    scene = pack((square(), material(0.7)), (lamp, material(0.5, emission=10.0)))
    poses = np.stack([look_at((0, -2, 0.9), (0, 0, 0.9)), look_at((0, -0.1, 2))])
    side, above = in_process(render, scene, poses, np.array([20, 20], np.float32), 16, 16, settings(**RAW))
    assert not side.any()  # the lamp's upper half before nothing
    assert (above > 0.1).all() and above.max() < 10  # the lit floor, seen through the lamp


@pytest.fixture(scope="module")
def view():
    return look_at((0.3, -1.5, 0.9), (0, 0, 0.1))


def test_rigid_motion_of_scene_and_camera_changes_nothing(in_process, view):
    precise = settings(samples=128)
    motion = rigid_motion()
    here = in_process(render, still_life(), one(view), one(40), 48, 48, precise)
    there = in_process(render, moved(still_life(), motion), one(motion @ view), one(40), 48, 48, precise)
    other = in_process(render, still_life(), one(motion @ view), one(40), 48, 48, precise)
    assert relative_error(there, here) < 0.05
    assert relative_error(other, here) > 0.5  # so the bound means something


@pytest.mark.parametrize(("height", "width"), [(48, 64), (64, 48)])
def test_gbuffer_agrees_with_cycles_passes(in_process, view, height, width):
    scene, fov = smooth(still_life()), 40.0
    center = settings(samples=1, denoise=False, filter_width=0.01)
    names = ["depth", "normal", "object_index"]
    passes = in_process(render_passes, scene, one(view), one(fov), height, width, center, names)
    gbuffer = first_hit(scene, view, fov, height, width)
    ids = object_ids(gbuffer, scene)
    assert (passes["object_index"][0] == ids + 1).mean() > 0.995
    both = (passes["object_index"][0] == ids + 1) & gbuffer.hit
    assert 0.3 < both.mean() < 1
    depth_error = np.abs(gbuffer.depth / passes["depth"][0] - 1)[both]
    assert np.quantile(depth_error, 0.99) < 1e-3
    cosine = np.einsum("hwx,hwx->hw", passes["normal"][0] @ view[:3, :3], gbuffer.normal)[both]
    assert np.degrees(np.arccos(np.clip(np.quantile(cosine, 0.01), -1, 1))) < 1


def smooth(scene):
    """The same scene with its ball's normals interpolated and the floor seen as if tilted."""
    normals = scene.normals.copy()
    start, end = scene.object_offsets[1:3]
    center = scene.positions[start:end].reshape(-1, 3).mean(0)
    normals[start:end] = scene.positions[start:end] - center
    normals[:2] += [0.2, 0, 0]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return dataclasses.replace(scene, normals=normals)


def test_left_is_left_and_up_is_up(in_process):
    red, green = (box(0.1, (-0.3, 0, 0)), material((1, 0, 0))), (box(0.1, (0, 0, 0.3)), material((0, 1, 0)))
    scene = pack(red, green, (box(4.0), material(emission=1.0)))
    image = in_process(render, scene, one(look_at((0, -1.5, 0))), one(40), 32, 32, settings())[0]
    left_row, left_column = np.mean(np.nonzero(image[..., 0] > 0.5), axis=1)
    top_row, top_column = np.mean(np.nonzero(image[..., 1] > 0.5), axis=1)
    assert left_column < 8 and abs(left_row - 15.5) < 1
    assert top_row < 8 and abs(top_column - 15.5) < 1


def test_diffuse_colors_per_triangle(in_process, view):
    scene, fov = still_life(), 40.0
    center = settings(samples=1, denoise=False, filter_width=0.01)
    color = in_process(render_passes, scene, one(view), one(fov), 48, 48, center, ["diffuse_color"])["diffuse_color"][0]
    gbuffer = first_hit(scene, view, fov, 48, 48)
    np.testing.assert_allclose(color[gbuffer.hit], scene.material[gbuffer.triangle[gbuffer.hit], :3], atol=1e-3)


def test_an_object_may_glow_in_part(in_process):
    """Only the emissive triangles of an object light the scene and hide from the camera."""
    walls = box(4.0)
    glowing = walls.mean(1)[:, 2] > 1.9  # the ceiling
    rows = np.where(glowing[:, None], material(emission=1.0), material(diffuse=0.5))
    scene = pack((walls, rows))
    poses = np.stack([look_at((0, 0, 0), (0, 0, 1), (0, 1, 0)), look_at((0, 0, 0), (0, 0, -1), (0, 1, 0))])
    up, down = in_process(render, scene, poses, np.array([40, 40], np.float32), 8, 8, settings(**RAW))
    assert not up.any() and (down > 0.05).all()


def test_same_seed_same_image_other_settings_another(in_process, view):
    def image(**changes):
        return in_process(render, still_life(), one(view), one(40), 32, 32, settings(**changes))

    base = image()
    np.testing.assert_array_equal(base, image())
    np.testing.assert_array_equal(base, image(threads=2))
    for changes in ({"seed": 1}, {"samples": 24}, {"denoise": False}, {"max_bounces": 0}, {"filter_width": 3.0}):
        assert (image(**changes) != base).any(), f"{changes} is not respected"


def test_denoising_comes_nearer_to_the_truth(in_process, view):
    def image(**changes):
        return in_process(render, still_life(), one(view), one(40), 48, 48, settings(**changes))

    truth = image(samples=1024, denoise=False)
    noisy = relative_error(image(samples=8, denoise=False), truth)
    assert relative_error(image(samples=8), truth) < 0.75 * noisy
    assert relative_error(image(samples=64, denoise=False), truth) < 0.5 * noisy


def test_images_are_finite_float32_of_the_requested_size(in_process, view):
    image = in_process(render, still_life(), one(view), one(40), 24, 32, settings())
    assert image.shape == (1, 24, 32, 3) and image.dtype == np.float32 and np.isfinite(image).all()


def test_broken_geometry_is_refused_by_name(in_process, view):
    degenerate, not_finite = still_life(), still_life()
    degenerate.positions[3, 2] = degenerate.positions[3, 1]
    not_finite.positions[3, 0, 0] = np.nan
    for scene in (degenerate, not_finite):
        with pytest.raises(SceneError, match="object_1.*repair"):
            in_process(render, scene, one(view), one(40), 8, 8, settings())


def test_an_unknown_pass_is_named(in_process, view):
    with pytest.raises(UserError, match="'beauty'.*combined"):
        in_process(render_passes, still_life(), one(view), one(40), 8, 8, settings(), ["beauty"])


def on_a_full_disk(*args):
    """Render (in the worker) where no file may grow beyond a few bytes, which fails writes as a full disk does."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    try:
        render(*args)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_is_one_clear_error(in_process, view):
    with pytest.raises(UserError, match="could not write .* free some space"):
        in_process(on_a_full_disk, still_life(), one(view), one(40), 64, 64, settings())


def leftovers(*args) -> dict:
    """Render twice (in the worker) and report what stays behind: on standard output, in the scene, on disk."""
    import bpy

    render(*args)
    objects = len(bpy.data.objects)
    with tempfile.TemporaryFile() as file:
        kept = os.dup(1)
        os.dup2(file.fileno(), 1)
        try:
            render(*args)
            os.write(1, b"audible")
        finally:
            os.dup2(kept, 1)
            os.close(kept)
        file.seek(0)
        printed = file.read()
    return {"printed": printed, "more": len(bpy.data.objects) - objects, "folder": os.path.exists(bpy.app.tempdir)}


def test_rendering_leaves_nothing_behind(in_process, view):
    left = in_process(leftovers, still_life(), one(view), one(40), 8, 8, settings())
    assert left == {"printed": b"audible", "more": 0, "folder": False}
