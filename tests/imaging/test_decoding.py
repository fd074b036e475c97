import numpy as np
import pytest
from PIL import Image

from rfpp.errors import UserError
from rfpp.imaging.decoding import read_radiance
from rfpp.imaging.exr import write_exr
from rfpp.imaging.panels import tone_mapped


def test_exr_is_read_unchanged_and_invalid_pixels_are_masked(tmp_path):
    image = np.random.default_rng(0).exponential(size=(4, 6, 3)).astype(np.float32)
    image[0, 0, 1], image[1, 1] = np.nan, 70000
    radiance, valid = read_radiance(write_exr(tmp_path / "a.exr", {"RGB": image}))
    assert not valid[0, 0] and valid.sum() == 23
    np.testing.assert_array_equal(radiance[valid], image[valid])


@pytest.mark.parametrize("stops", [0.0, 2.0])
def test_8_bits_are_linearized_and_clipped_pixels_are_masked(tmp_path, stops):
    image = np.linspace(0, 2, 4 * 6 * 3, dtype=np.float32).reshape(4, 6, 3) * 2.0**-stops
    Image.fromarray(tone_mapped(image, stops)).save(tmp_path / "a.png")
    radiance, valid = read_radiance(tmp_path / "a.png", stops)
    displayed = image.max(-1) * 2.0**stops
    assert valid[displayed < 0.98].all() and not valid[displayed > 1].any()
    np.testing.assert_allclose(radiance[valid], image[valid], atol=0.006 * 2.0**-stops)


def test_other_files_are_refused_in_one_line(tmp_path):
    (tmp_path / "a.png").write_bytes(b"nothing")
    write_exr(tmp_path / "depth.exr", {"depth.Z": np.zeros((2, 2), np.float32)})
    for name, message in {
        "a.png": "not a readable picture",
        "gone.png": "No such file",
        "depth.exr": "has no layer RGB",
    }.items():
        with pytest.raises(UserError, match=message) as refused:
            read_radiance(tmp_path / name)
        assert name in str(refused.value) and "\n" not in str(refused.value)
