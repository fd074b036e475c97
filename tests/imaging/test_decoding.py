"""Pictures back to radiance."""

import numpy as np
import pytest
from PIL import Image

from rfpp.errors import UserError
from rfpp.imaging.decoding import read_radiance
from rfpp.imaging.exr import write_exr
from rfpp.imaging.panels import tone_mapped


def test_exr_is_read_as_it_is_and_what_is_no_number_is_not_known(tmp_path):
    image = np.random.default_rng(0).exponential(size=(4, 6, 3)).astype(np.float32)
    image[0, 0, 1], image[1, 1] = np.nan, 70000
    radiance, known = read_radiance(write_exr(tmp_path / "a.exr", {"RGB": image}))
    assert not known[0, 0] and known.sum() == 23
    np.testing.assert_array_equal(radiance[known], image[known])


@pytest.mark.parametrize("stops", [0.0, 2.0])
def test_eight_bits_lose_their_curve_and_what_is_clipped_is_not_known(tmp_path, stops):
    image = np.linspace(0, 2, 4 * 6 * 3, dtype=np.float32).reshape(4, 6, 3) * 2.0**-stops
    Image.fromarray(tone_mapped(image, stops)).save(tmp_path / "a.png")
    radiance, known = read_radiance(tmp_path / "a.png", stops)
    shown = image.max(-1) * 2.0**stops
    assert known[shown < 0.98].all() and not known[shown > 1].any()
    np.testing.assert_allclose(radiance[known], image[known], atol=0.006 * 2.0**-stops)


def test_what_is_no_picture_is_one_line(tmp_path):
    (tmp_path / "a.png").write_bytes(b"nothing")
    write_exr(tmp_path / "depth.exr", {"depth.Z": np.zeros((2, 2), np.float32)})
    for name, message in {"a.png": "no picture", "gone.png": "No such file", "depth.exr": "has no layer RGB"}.items():
        with pytest.raises(UserError, match=message) as refused:
            read_radiance(tmp_path / name)
        assert name in str(refused.value) and "\n" not in str(refused.value)
