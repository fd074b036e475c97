"""G-buffers in EXR files: names that other programs know, and values that come back."""

import io

import numpy as np
import OpenEXR
import pytest
from known_scenes import look_at, still_life

from rfpp.errors import UserError
from rfpp.imaging.exr import read_exr
from rfpp.imaging.tone_maps import SRGB
from rfpp.inference.layers import checked_layers, exr_layers
from rfpp.inference.stills import write_still
from rfpp.raycast.first_hit import CHANNELS, channel, first_hit, stack_channels

NAMES = ("normal", "depth", "albedo", "roughness", "position")


@pytest.fixture(scope="module")
def seen():
    triangles = still_life()
    return triangles, first_hit(triangles, look_at((0.2, -1.5, 0.8)), 45, 12, 16)


def test_layers_read_back_by_their_conventional_names(seen, tmp_path):
    triangles, gbuffer = seen
    stacked = stack_channels(gbuffer, triangles.material, 45, NAMES)
    image = np.random.default_rng(0).random((12, 16, 3)).astype(np.float32)
    write_still(image, tmp_path / "view.exr", SRGB(), exr_layers(stacked, NAMES))

    with OpenEXR.File(io.BytesIO((tmp_path / "view.exr").read_bytes()), separate_channels=True) as file:
        names = set(file.channels())
    expected = {"R", "G", "B", "depth.Z", "roughness.Y"}
    expected |= {f"{layer}.{axis}" for layer in ("normal", "position") for axis in "XYZ"}
    assert names == expected | {f"albedo.{axis}" for axis in "RGB"}

    layers = read_exr(tmp_path / "view.exr")
    np.testing.assert_allclose(layers["RGB"], image, rtol=1e-3)
    np.testing.assert_array_equal(layers["depth.Z"], gbuffer.depth)
    assert layers["depth.Z"].dtype == layers["position.X"].dtype == np.float32
    normal = np.stack([layers[f"normal.{axis}"] for axis in "XYZ"], axis=-1)
    np.testing.assert_array_equal(normal, gbuffer.normal.astype(np.float16))
    albedo = channel(gbuffer, triangles.material, 45, "albedo").astype(np.float16)
    np.testing.assert_array_equal(layers["albedo"], albedo)
    assert (tmp_path / "view.png").is_file()


def test_every_channel_of_a_gbuffer_can_be_a_layer():
    names = tuple(CHANNELS)
    numbers = np.arange(sum(CHANNELS[name] for name in names), dtype=np.float32)
    stacked = numbers[:, None, None] * np.ones((1, 2, 3), np.float32)
    layers = exr_layers(stacked, checked_layers(names))
    assert [plane[0, 0] for plane in layers.values()] == list(range(len(stacked)))
    assert exr_layers(stacked[:0], ()) == {}


def test_what_is_no_layer_is_refused_with_those_that_are():
    with pytest.raises(UserError, match=r"'normals' does not exist: choose from normal, .*depth"):
        checked_layers(["depth", "normals"])
    with pytest.raises(UserError, match="twice"):
        checked_layers(["depth", "depth"])
