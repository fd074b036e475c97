"""Files of single images: layers under conventional names, and writing in the background."""

import errno
import io
from threading import Event

import numpy as np
import OpenEXR
import pytest
from known_scenes import look_at, still_life

from rfpp.imaging.exr import read_exr
from rfpp.imaging.tone_maps import SRGB
from rfpp.inference.stills import (
    bounce_layers,
    darkness,
    gbuffer_layers,
    light_layers,
    write_still,
    written_in_background,
)
from rfpp.raycast.first_hit import channel, first_hit, stack_channels

NAMES = ("normal", "depth", "albedo", "roughness", "position")
IMAGES = np.random.default_rng(0).uniform(0, 1, (4, 12, 16, 3)).astype(np.float32)


def test_layers_have_conventional_names_and_round_trip(tmp_path):
    triangles = still_life()
    gbuffer = first_hit(triangles, look_at((0.2, -1.5, 0.8)), 45, 12, 16)
    stacked = stack_channels(gbuffer, triangles.material, 45, NAMES)
    write_still(IMAGES[0], tmp_path / "view.exr", SRGB(), gbuffer_layers(stacked, NAMES))
    with OpenEXR.File(io.BytesIO((tmp_path / "view.exr").read_bytes()), separate_channels=True) as file:
        names = set(file.channels())
    expected = {"R", "G", "B", "depth.Z", "roughness.Y"} | {f"albedo.{axis}" for axis in "RGB"}
    assert names == expected | {f"{layer}.{axis}" for layer in ("normal", "position") for axis in "XYZ"}

    layers = read_exr(tmp_path / "view.exr")
    np.testing.assert_array_equal(layers["RGB"], IMAGES[0].astype(np.float16))
    np.testing.assert_array_equal(layers["depth.Z"], gbuffer.depth)
    assert layers["depth.Z"].dtype == layers["position.X"].dtype == np.float32
    normal = np.stack([layers[f"normal.{axis}"] for axis in "XYZ"], axis=-1)
    np.testing.assert_array_equal(normal, gbuffer.normal.astype(np.float16))
    albedo = channel(gbuffer, triangles.material, 45, "albedo").astype(np.float16)
    np.testing.assert_array_equal(layers["albedo"], albedo)
    assert (tmp_path / "view.png").is_file()


def test_lights_with_similar_names_and_bounces_are_distinct_layers():
    lights = light_layers({"lamp 1": IMAGES[0], "lamp.1": IMAGES[1]})
    assert sorted(lights) == [f"light_lamp_1{suffix}.{c}" for suffix in ("", "_1") for c in "BGR"]
    np.testing.assert_array_equal(lights["light_lamp_1_1.G"], IMAGES[1][..., 1].astype(np.float16))
    assert list(bounce_layers(list(IMAGES[:2]))) == [f"bounce_0{number}.{c}" for number in (1, 2) for c in "RGB"]


def test_images_are_written_while_others_are_rendered():
    begun, finish, written = Event(), Event(), {}

    def write(image, target):
        begun.set()
        assert finish.wait(timeout=60)
        written[target] = image

    def rendering():
        yield IMAGES[0]
        assert begun.wait(timeout=60)
        finish.set()
        yield IMAGES[1]

    images = list(written_in_background(rendering(), ["a", "b"], write))
    np.testing.assert_array_equal(images, IMAGES[:2])
    np.testing.assert_array_equal([written["a"], written["b"]], IMAGES[:2])
    assert list(written_in_background([], [], print)) == []


def test_rendering_stops_when_writing_fails():
    rendered = []

    def write(image, target):
        raise OSError(errno.ENOSPC, "No space left on device", target)

    def rendering():
        for number, image in enumerate(IMAGES):
            rendered.append(number)
            yield image

    with pytest.raises(OSError, match="No space left"):
        list(written_in_background(rendering(), list("abcd"), write))
    assert rendered == [0, 1]


def test_a_picture_without_visible_pixels_comes_with_advice():
    assert darkness(IMAGES[0], SRGB()) is None
    small = np.zeros((40, 40, 3), np.float32)
    small[:6, :6] = 0.5  # a small object before a black background
    assert darkness(small, SRGB()) is None
    dim = np.full((40, 40, 3), 0.001, np.float32)
    assert "try exposure=9" in darkness(dim, SRGB())
    assert darkness(dim, SRGB(9)) is None
    assert "no light reaches" in darkness(np.zeros_like(dim), SRGB())
