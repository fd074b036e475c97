"""Textures: the mean over a triangle, whatever its size, in linear light; and pictures that are none."""

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from rfpp.errors import SceneError
from rfpp.scene.io.image_texture import ImageTexture, Textures, require_few_pixels


def png(pixels: np.ndarray) -> bytes:
    content = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(content, "PNG")
    return content.getvalue()


def halves(size: int) -> np.ndarray:
    """Black on the left and white on the right."""
    pixels = np.zeros((size, size, 3))
    pixels[:, size // 2 :] = 255
    return pixels


@pytest.mark.parametrize("size", [2, 64, 301, 3000])
def test_the_mean_over_a_triangle_is_that_of_the_light(size: int) -> None:
    texture = ImageTexture(png(halves(size)), color=True)
    whole = np.array([[[0, 0], [1, 0], [0, 1]], [[0.1, 0], [0.4, 0], [0.1, 1]], [[0.6, 0], [0.9, 0], [0.6, 1]]])
    # Of the lower left triangle a quarter lies in the right half.
    np.testing.assert_allclose(texture.means(whole)[:, 0], [0.25, 0, 1], atol=0.04)


def test_fine_detail_under_a_large_triangle_is_averaged_not_sampled() -> None:
    checker = np.indices((512, 512)).sum(axis=0)[..., None] % 2 * np.full(3, 255)
    texture = ImageTexture(png(checker), color=True)
    uv = np.add(np.random.default_rng(0).uniform(size=(50, 1, 2)), [[[0, 0], [0.7, 0.1], [0.1, 0.7]]])
    np.testing.assert_allclose(texture.means(uv)[:, 0], 0.5, atol=0.02)


def test_colors_are_linear_and_numbers_are_not_touched() -> None:
    content, uv = png(np.full((4, 4, 3), 188)), np.zeros((1, 3, 2))
    np.testing.assert_allclose(ImageTexture(content, color=True).means(uv)[0], [0.503] * 3 + [1], atol=1e-3)
    np.testing.assert_allclose(ImageTexture(content, color=False).means(uv)[0], [188 / 255] * 3 + [1], atol=1e-3)


def test_textures_repeat() -> None:
    texture = ImageTexture(png(halves(8)), color=True)
    small = np.array([[0.7, 0.5], [0.8, 0.5], [0.7, 0.6]])
    for shift in (0, 1, -3, 1e6):
        np.testing.assert_allclose(texture.means(small[None] + shift)[0], 1)


@pytest.mark.parametrize(
    ("wrap", "left", "within", "right"), [("repeat", 1, 0, 0), ("clamp", 0, 0, 1), ("mirror", 0, 0, 1)]
)
def test_what_is_beyond_an_edge(wrap: str, left: float, within: float, right: float) -> None:
    small = np.array([[0, 0.5], [0.05, 0.5], [0, 0.55]])
    at = np.array([[-0.2, 0], [0.2, 0], [1.2, 0]])[:, None]
    texture = ImageTexture(png(halves(16)), color=True, wrap=(wrap, "repeat"))
    np.testing.assert_allclose(texture.means(small + at)[:, 0], [left, within, right], atol=1e-3)
    upright = ImageTexture(png(halves(16).swapaxes(0, 1)), color=True, wrap=("repeat", wrap))
    np.testing.assert_allclose(upright.means((small + at)[..., ::-1])[:, 0], [left, within, right], atol=1e-3)


def test_textures_are_decoded_once_counted_and_not_too_many(monkeypatch) -> None:
    textures, read = Textures(), []
    for key in (1, 2, 1, 2, 1):
        textures.get(key, True, lambda key=key: read.append(key) or png(halves(8)))
    assert read == [1, 2]
    assert textures.used == 2
    monkeypatch.setattr("rfpp.scene.io.image_texture._MAX_PIXELS_OF_A_FILE", 200)
    textures.get(3, True, lambda: png(halves(8)))
    with pytest.raises(SceneError, match="its textures have more than 200 pixels"):
        textures.get(4, True, lambda: png(halves(8)))


def claiming(width: int, height: int) -> bytes:
    """A PNG of one pixel whose header says otherwise."""
    content = bytearray(png(np.zeros((1, 1, 3))))
    content[16:24] = struct.pack(">II", width, height)
    content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
    return bytes(content)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "cannot be read as an image"),
        (b"GIF89a", "cannot be read as an image"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "cannot be read as an image"),
        (png(halves(64))[:-60], "cannot be read as an image"),
        (claiming(9000, 9000), "9000 x 9000 pixels is too large"),
        (claiming(2**31 - 1, 2**31 - 1), "too large"),
    ],
)
def test_what_is_no_image_or_an_absurd_one_is_refused(content: bytes, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        ImageTexture(content, color=True)


@pytest.mark.parametrize("turned", [False, True])
def test_a_very_long_image_has_the_mean_of_its_pixels(turned: bool) -> None:
    shades = np.random.default_rng(0).integers(0, 256, (1, 300_001, 3), np.uint8)
    texture = ImageTexture(png(shades.swapaxes(0, 1) if turned else shades), color=False)
    whole = np.array([[[0, 0], [1, 0], [0, 1]], [[1, 1], [0, 1], [1, 0]]], np.float64)
    np.testing.assert_allclose(texture.means(whole)[:, :3].mean(0), shades.mean((0, 1)) / 255, atol=0.01)


def test_a_bomb_in_a_text_chunk_is_no_image() -> None:
    text = b"note\0\0" + zlib.compress(bytes(80_000_000), 9)
    chunk = struct.pack(">I", len(text)) + b"zTXt" + text + struct.pack(">I", zlib.crc32(b"zTXt" + text))
    content = png(halves(8))
    content = content[:33] + chunk + content[33:]  # after the header
    require_few_pixels([io.BytesIO(content)])
    with pytest.raises(SceneError, match="cannot be read as an image"):
        ImageTexture(content, color=True)
