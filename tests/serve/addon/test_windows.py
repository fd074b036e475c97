import numpy as np
from addon_modules import addon

windows = addon("windows")


def frustum(left: float, right: float, bottom: float, top: float, near: float = 0.1, far: float = 100.0) -> np.ndarray:
    """The projection matrix of OpenGL, from edges at the near plane."""
    return np.array(
        [
            [2 * near / (right - left), 0, (right + left) / (right - left), 0],
            [0, 2 * near / (top - bottom), (top + bottom) / (top - bottom), 0],
            [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, -1, 0],
        ]
    )


def test_the_window_of_a_projection_is_its_frustum():
    np.testing.assert_allclose(windows.window_of(frustum(-0.05, 0.03, -0.02, 0.04)), (-0.5, 0.3, -0.2, 0.4))


def test_parts_start_at_the_bottom():
    whole = (-0.5, 0.5, -0.25, 0.25)
    np.testing.assert_allclose(windows.part_of(whole, (50, 100), (25, 0, 50, 25)), (-0.25, 0.25, -0.25, 0.0))
    np.testing.assert_allclose(windows.part_of(whole, (50, 100), (0, 0, 100, 50)), whole)
