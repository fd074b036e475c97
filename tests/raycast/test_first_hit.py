import dataclasses

import numpy as np
import pytest
from camera_rays import pixel_rays
from known_scenes import LIGHT, box, look_at, material, moved, pack, rigid_motion, sphere, square, still_life

from rfpp.errors import UserError
from rfpp.raycast.first_hit import CHANNELS, camera_caster, camera_positions, first_hit, object_ids, stack_channels


def test_a_plane_seen_from_above_has_its_depth_and_normal():
    gbuffer = first_hit(pack((square(4), material(0.5))), look_at((0, 0, 1.5), up=(0, 1, 0)), 60, 8, 12)
    np.testing.assert_allclose(gbuffer.depth, 1.5, rtol=1e-5)  # planar: the same in every pixel
    np.testing.assert_allclose(gbuffer.normal, np.broadcast_to([0, 0, 1], (8, 12, 3)), atol=1e-6)


def test_a_plane_seen_from_below_faces_the_camera_too():
    gbuffer = first_hit(pack((square(4), material(0.5))), look_at((0.1, 0, -1.5)), 40, 8, 8)
    assert gbuffer.hit.all()
    towards_camera = -camera_positions(gbuffer.depth, 40)
    assert (np.einsum("hwx,hwx->hw", gbuffer.normal, towards_camera) > 0).all()


def test_a_smooth_sphere_matches_its_closed_form():
    radius, distance, fov, size = 0.4, 1.6, 40.0, 33
    ball = pack((sphere(radius, subdivisions=5), material(0.5)))
    ball = dataclasses.replace(ball, normals=(ball.positions / radius).astype(np.float32))
    pose = look_at((0.3, -1.2, 0.8))
    pose[:3, 3] *= distance / np.linalg.norm(pose[:3, 3])
    gbuffer = first_hit(ball, pose, fov, size, size)

    origins, directions = (a.astype(np.float64) for a in pixel_rays(pose, fov, size, size))
    along = -(origins * directions).sum(-1)
    root = radius**2 - distance**2 + along**2
    inside = root > 0.02**2  # away from the silhouette, which the mesh only approximates
    points = origins + (along - np.sqrt(np.maximum(root, 0)))[..., None] * directions
    depth = (points - pose[:3, 3]) @ -pose[:3, 2]
    normal = points / radius @ pose[:3, :3]
    assert gbuffer.hit[inside].all() and not gbuffer.hit[root < -(0.02**2)].any()
    np.testing.assert_allclose(gbuffer.depth[inside], depth[inside], rtol=2e-3)
    assert (np.einsum("px,px->p", gbuffer.normal[inside], normal[inside]) > np.cos(np.radians(2))).all()
    assert (gbuffer.depth[~gbuffer.hit] == 0).all() and (gbuffer.normal[~gbuffer.hit] == 0).all()


def test_left_is_left_and_up_is_up():
    scene = pack((box(0.1, (-0.3, 0, 0)), material(0.5)), (box(0.1, (0, 0, 0.3)), material(0.5)))
    ids = object_ids(first_hit(scene, look_at((0, -1.5, 0)), 40, 32, 32), scene)
    left_row, left_column = np.mean(np.nonzero(ids == 0), axis=1)
    top_row, top_column = np.mean(np.nonzero(ids == 1), axis=1)
    assert left_column < 8 and abs(left_row - 15.5) < 1
    assert top_row < 8 and abs(top_column - 15.5) < 1


def test_lights_are_invisible_and_ids_survive_their_removal():
    scene = pack((LIGHT * 4, material(emission=10.0)), (square(1, z=-0.3), material(0.5)))
    gbuffer = first_hit(scene, look_at((0, 0, 1), up=(0, 1, 0)), 30, 9, 9)
    assert set(np.unique(gbuffer.triangle)) == {1, 2}
    assert (object_ids(gbuffer, scene) == 1).all()
    np.testing.assert_allclose(gbuffer.depth, 1.3, rtol=1e-5)


def test_a_scene_of_lights_only_is_empty_to_the_camera():
    gbuffer = first_hit(pack((LIGHT, material(emission=10.0))), look_at((0, 0, 1), up=(0, 1, 0)), 30, 4, 4)
    assert not gbuffer.hit.any()


def test_rigid_motion_of_scene_and_camera_changes_nothing():
    scene, pose, motion = still_life(), look_at((0.3, -1.5, 0.9), (0, 0, 0.1)), rigid_motion()
    here = first_hit(scene, pose, 40, 48, 48)
    there = first_hit(moved(scene, motion), (motion @ pose).astype(np.float32), 40, 48, 48)
    same = here.triangle == there.triangle
    assert same.mean() > 0.995  # but for rays through an edge
    np.testing.assert_allclose(here.depth[same], there.depth[same], atol=1e-5)
    np.testing.assert_allclose(here.normal[same], there.normal[same], atol=1e-5)


def test_channels_are_stacked_in_the_order_asked_for():
    scene = still_life()
    pose = look_at((0.3, -1.5, 0.9), (0, 0, 0.1))
    gbuffer = first_hit(scene, pose, 60, 24, 32)
    names = ["position", "albedo", "roughness", "normal", "specular", "depth"]
    stacked = stack_channels(gbuffer, scene.material, 60, names)
    assert stacked.shape == (14, 24, 32) and stacked.dtype == np.float32
    assert 0 < gbuffer.hit.mean() < 1 and not stacked[:, ~gbuffer.hit].any()
    parts = dict(zip(names, np.split(stacked, np.cumsum([CHANNELS[n] for n in names])[:-1]), strict=True))
    row = scene.material[gbuffer.triangle[gbuffer.hit]]
    np.testing.assert_array_equal(parts["albedo"][:, gbuffer.hit].T, row[:, 0:3])
    np.testing.assert_array_equal(parts["specular"][:, gbuffer.hit].T, row[:, 3:6])
    np.testing.assert_array_equal(parts["roughness"][:, gbuffer.hit].T, row[:, 6:7])
    np.testing.assert_array_equal(parts["depth"][0], gbuffer.depth)
    np.testing.assert_array_equal(parts["normal"], gbuffer.normal.transpose(2, 0, 1))
    twice = stack_channels(gbuffer, scene.material, 60, ["depth", "normal", "depth"])  # two networks may ask for it
    np.testing.assert_array_equal(twice, np.stack([gbuffer.depth, *parts["normal"], gbuffer.depth]))


def test_positions_lie_on_the_triangles_they_belong_to():
    scene, pose = still_life(), look_at((0.3, -1.5, 0.9), (0, 0, 0.1))
    gbuffer = first_hit(scene, pose, 60, 24, 32)
    position = stack_channels(gbuffer, scene.material, 60, ["position"]).transpose(1, 2, 0)[gbuffer.hit]
    world = position @ pose[:3, :3].T + pose[:3, 3]
    hit = gbuffer.triangle[gbuffer.hit]
    off_plane = np.einsum("px,px->p", world - scene.positions[hit, 0], scene.normals[hit, 0])
    np.testing.assert_allclose(off_plane, 0, atol=1e-5)


def test_an_unknown_channel_is_named():
    scene = still_life()
    with pytest.raises(UserError, match="'color'.*albedo"):
        stack_channels(first_hit(scene, look_at((0, -1, 1)), 40, 4, 4), scene.material, 40, ["color"])


def test_a_caster_is_reused_but_not_that_of_another_scene():
    scene, pose = still_life(), look_at((0.3, -1.5, 0.9))
    shared = first_hit(scene, pose, 40, 8, 8, camera_caster(scene))
    np.testing.assert_array_equal(shared.triangle, first_hit(scene, pose, 40, 8, 8).triangle)
    with pytest.raises(ValueError, match="camera_caster"):
        first_hit(scene, pose, 40, 8, 8, camera_caster(pack((square(), material(0.5)))))
