from __future__ import annotations

import numpy as np
import pytest
from camera_rays import pixel_rays

from rfpp.scene.camera import camera_to_world, pixel_plane
from rfpp.scene.spec import Camera

CAMERA = Camera(position=(0.0, -2.0, 0.5), look_at=(0.1, 0.0, 0.2), fov=40.0)


def in_camera(point: tuple[float, float, float], camera: Camera = CAMERA) -> np.ndarray:
    return (np.linalg.inv(camera_to_world(camera)) @ [*point, 1.0])[:3]


def test_the_pose_is_a_rotation_and_the_position() -> None:
    c2w = camera_to_world(CAMERA)
    assert c2w.dtype == np.float32
    np.testing.assert_allclose(c2w[:3, :3].T @ c2w[:3, :3], np.eye(3), atol=1e-6)
    assert np.linalg.det(c2w[:3, :3]) == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(c2w[:, 3], [*CAMERA.position, 1], atol=1e-7)


def test_it_looks_along_minus_z_with_x_right_and_y_up() -> None:
    np.testing.assert_allclose(in_camera(CAMERA.look_at)[:2], 0, atol=1e-6)
    assert in_camera(CAMERA.look_at)[2] < 0
    assert in_camera((0.4, 0.0, 0.2))[0] > 0, "a point to the right of the look-at point"
    assert in_camera((0.1, 0.0, 0.5))[1] > 0, "a point above the look-at point"


@pytest.mark.parametrize(("height", "width"), [(4, 4), (4, 8), (8, 4), (1, 1), (5, 3)])
def test_the_longer_side_spans_minus_one_to_one(height: int, width: int) -> None:
    plane = pixel_plane(height, width)
    pixel = 2 / max(height, width)
    assert plane.shape == (height, width, 2)
    edges = np.stack([plane.min(axis=(0, 1)) - pixel / 2, plane.max(axis=(0, 1)) + pixel / 2])
    expected = np.array([width, height]) / max(height, width)
    np.testing.assert_allclose(edges, [-expected, expected], atol=1e-6)


@pytest.mark.parametrize("points", [2, 3])
def test_points_of_a_pixel_share_neither_row_nor_column_and_lie_around_its_center(points: int) -> None:
    height, width = 4, 6
    plane = pixel_plane(points * height, points * width, points)
    of_pixels = plane.reshape(height, points, width, points, 2).swapaxes(1, 2).reshape(height, width, points**2, 2)
    np.testing.assert_allclose(of_pixels.mean(2), pixel_plane(height, width), atol=1e-6)
    offsets = np.sort(of_pixels - of_pixels.mean(2, keepdims=True), axis=2)
    apart = 2 / max(height, width) / points**2
    np.testing.assert_allclose(np.diff(offsets, axis=2), apart, atol=1e-6)


@pytest.mark.parametrize(("height", "width"), [(6, 6), (6, 10), (10, 6)])
def test_rays_go_through_the_pixels_they_belong_to(height: int, width: int) -> None:
    c2w = camera_to_world(CAMERA)
    origins, directions = pixel_rays(c2w, CAMERA.fov, height, width)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-6)
    np.testing.assert_array_equal(origins, np.broadcast_to(c2w[:3, 3], origins.shape))
    local = directions @ c2w[:3, :3]
    projected = local[..., :2] / -local[..., 2:] / np.tan(np.radians(CAMERA.fov) / 2)
    np.testing.assert_allclose(projected, pixel_plane(height, width), atol=1e-5)
