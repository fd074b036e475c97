"""Windows into a scene as part of images that a network can render."""

import numpy as np
import pytest
from camera_rays import pixel_rays

from rfpp.errors import SceneError
from rfpp.serve.image_window import ImageWindow


@pytest.mark.parametrize(
    ("edges", "size"),
    [
        ((-0.5, 0.5, -0.3, 0.3), (60, 100)),  # a multiple of nothing
        ((-0.5, 0.5, -0.25, 0.25), (64, 128)),
        ((-0.2, 0.8, -0.4, 0.2), (60, 100)),  # shifted
        ((0.1, 0.3, -0.4, -0.2), (40, 40)),  # beside the middle
    ],
)
def test_pixels_are_those_of_the_window(edges, size):
    window = ImageWindow.around(edges, size, 16)
    assert window.image_size[0] % 16 == 0 and window.image_size[1] % 16 == 0
    _, directions = pixel_rays(np.eye(4, dtype=np.float32), window.fov, *window.image_size)
    cut = window.crop(directions / -directions[..., 2:])
    assert cut.shape[:2] == size
    left, right, bottom, top = edges
    pitch = (right - left) / size[1]
    np.testing.assert_allclose(cut[0, 0, :2], [left + pitch / 2, top - pitch / 2], atol=pitch / 100)
    np.testing.assert_allclose(cut[-1, -1, :2], [right - pitch / 2, bottom + pitch / 2], atol=pitch / 100)


def test_odd_sizes_are_off_by_half_a_pixel():
    window = ImageWindow.around((-0.5, 0.5, -0.3, 0.3), (63, 105), 8)
    _, directions = pixel_rays(np.eye(4, dtype=np.float32), window.fov, *window.image_size)
    middle = window.crop(directions / -directions[..., 2:])[31, 52, :2]
    np.testing.assert_allclose(np.abs(middle), 0.5 / 105, atol=1e-5)
    assert ImageWindow.around((-0.5, 0.5, -0.5, 0.5), (64, 64), 8).image_size == (64, 64)


@pytest.mark.parametrize(
    ("edges", "size", "why"),
    [
        ((0.5, -0.5, -0.5, 0.5), (8, 8), "is empty"),
        ((-0.5, 0.5, 0.5, 0.5), (8, 8), "is empty"),
        ((-0.5, 0.5, -0.25, 0.25), (8, 8), "not square"),
        ((100.0, 100.1, -0.05, 0.05), (64, 64), "too far off center"),
        ((-1e-9, 1e-9, -1e-9, 1e-9 + 900), (1, 16384), "not square"),
    ],
)
def test_invalid_windows_are_refused(edges, size, why):
    with pytest.raises(SceneError, match=why):
        ImageWindow.around(edges, size, 8)
