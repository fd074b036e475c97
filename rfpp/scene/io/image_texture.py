"""Textures, averaged over each triangle, because networks take one material per triangle."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable
from functools import cached_property

import numpy as np
from jaxtyping import Float
from PIL import Image

from rfpp.errors import SceneError

#: Only formats whose readers run no other program.
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF")
_MAX_PIXELS = 8192 * 8192
_MAX_PIXELS_OF_A_FILE = 2**28  # 16 pictures of 4096²
_SIDE_KEPT = 1024  # pixels along the longer side; 11 MB with all coarser copies
_KEPT = 32  # pictures
_TILE = 2**17  # pixels that are reduced at a time
_SLICES = 32  # slices of pixels that are added one by one
_TINY = 1.01  # pixels along a triangle that one point stands for
_SIDE = 6  # cells along a triangle's side: 36 equal parts, each looked up at its center
_CHUNK = 50_000  # triangles at a time: 45 MB
_UNIFORM = 0.01  # standard deviation below which texels are left out

#: 8-bit sRGB → linear.
_LINEAR = np.where(
    np.arange(256) <= 0.04045 * 255, np.arange(256) / 255 / 12.92, ((np.arange(256) / 255 + 0.055) / 1.055) ** 2.4
).astype(np.float32)

_PLAIN = (np.arange(256) / 255).astype(np.float32)


class ImageTexture:
    """Image that repeats in u and v, as a mip map.

    Attributes:
        pixels: Number of pixels in its file.

    Args:
        content: Image file.
        color: The image holds sRGB color, which is made linear; else plain numbers.
        left: Pixels that the scene may still load.

    Raises:
        SceneError: If the image is damaged or too large; without the file's name.
    """

    def __init__(self, content: bytes, color: bool, left: int = _MAX_PIXELS) -> None:
        picture, self.pixels = _pixels(content, color, left)
        self._levels = _mip_map(picture)

    @cached_property
    def _squares(self) -> list[np.ndarray]:
        """Mip map of the squares, for spreads."""
        return _mip_map(np.square(self._levels[0], dtype=np.float32))

    def means(self, uv: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, "f 4"]:
        """Return red, green, blue and alpha of each triangle; (0, 0) is the image's upper left corner."""
        return _means(self._levels, uv)

    def pixels_along(self, uv: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, " f"]:
        """Return the number of pixels along each triangle; 0 where the picture hardly varies."""
        height, width = self._levels[0].shape[:2]
        along = (np.ptp(uv, axis=1) * (width, height)).max(axis=1)
        return np.where((self.spreads(uv) > _UNIFORM).any(axis=1), along, 0)

    def spreads(self, uv: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, "f 4"]:
        """Return the standard deviation of these within each triangle."""
        return np.sqrt(np.maximum(_means(self._squares, uv) - self.means(uv) ** 2, 0))


class Textures:
    """Textures of one scene file, with a cache of the last used."""

    def __init__(self) -> None:
        self._seen: set[tuple[Hashable, bool]] = set()
        self._kept: OrderedDict[tuple[Hashable, bool], ImageTexture] = OrderedDict()
        self._pixels = 0

    @property
    def used(self) -> int:
        """Number of different textures."""
        return len(self._seen)

    def get(self, key: Hashable, color: bool, read: Callable[[], bytes]) -> ImageTexture:
        """Return the texture decoded from the bytes of `read`. Raises SceneError like `ImageTexture`."""
        if (key, color) not in self._kept:
            texture = ImageTexture(read(), color, _MAX_PIXELS_OF_A_FILE - self._pixels)
            self._pixels += texture.pixels
            self._seen.add((key, color))
            self._kept[key, color] = texture
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end((key, color))
        return self._kept[key, color]


def require_few_pixels(files: Iterable[io.BufferedIOBase]) -> None:
    """Close image files; raise SceneError if their headers name too many pixels together."""
    pixels = 0
    for file in files:
        with file, contextlib.suppress(Exception):  # no image: refused when it is read
            image = _opened(file)
            pixels += image.width * image.height
        if pixels > _MAX_PIXELS_OF_A_FILE:
            raise _too_many_pixels()


def linear(srgb: np.ndarray) -> np.ndarray:
    """Convert 8-bit sRGB to linear float32 in [0, 1]."""
    return _LINEAR[srgb]


def _mip_map(level: Float[np.ndarray, "h w 4"]) -> list[np.ndarray]:
    levels = [level.astype(np.float16)]
    while min(level.shape[:2]) > 1:
        level = _reduced(level, 2, 2)
        levels.append(level.astype(np.float16))
    return levels


def _means(levels: list[np.ndarray], uv: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, "f 4"]:
    parts = [_means_of_some(levels, uv[i : i + _CHUNK]) for i in range(0, len(uv), _CHUNK)]
    return np.concatenate([np.empty((0, 4), np.float32), *parts])


def _means_of_some(levels: list[np.ndarray], uv: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, "f 4"]:
    height, width = levels[0].shape[:2]
    extent = (np.ptp(uv, axis=1) * (width, height)).max(axis=1)
    wanted = np.log2(np.maximum(extent / _SIDE, 1))
    level = np.minimum(np.floor(wanted), len(levels) - 1).astype(int)
    level[extent <= _TINY] = -1  # within a pixel: one point is enough
    result = np.empty((len(uv), 4), np.float32)
    for number in np.unique(level):
        chosen, pixels = level == number, levels[max(number, 0)]
        size, corners = np.array([pixels.shape[1], pixels.shape[0]]), uv[chosen]
        points = _CENTERS @ corners if number >= 0 else corners.mean(axis=1, keepdims=True)
        x, y = np.moveaxis(np.minimum(np.floor(points % 1.0 * size), size - 1).astype(int), -1, 0)
        result[chosen] = pixels[y, x].mean(axis=1, dtype=np.float32)
    return result


def _centers() -> np.ndarray:
    """Return barycentric coordinates [36, 3] of the centers of a triangle's equal parts."""
    cells = [(i, j) for i in range(_SIDE) for j in range(_SIDE - i)]
    upright = np.array([(i + 1 / 3, j + 1 / 3) for i, j in cells])
    inverted = np.array([(i + 2 / 3, j + 2 / 3) for i, j in cells if i + j < _SIDE - 1])
    u, v = np.concatenate([upright, inverted]).T / _SIDE
    return np.stack([1 - u - v, u, v], axis=1)


_CENTERS = _centers()


def _pixels(content: bytes, color: bool, left: int) -> tuple[Float[np.ndarray, "h w 4"], int]:
    """Return the reduced image, and the number of pixels in its file."""
    try:
        image = _opened(io.BytesIO(content))
        if image.width * image.height > _MAX_PIXELS:
            raise SceneError(f"an image of {image.width} x {image.height} pixels is too large: make it smaller")
        if image.width * image.height > left:
            raise _too_many_pixels()
        image.load()
    except SceneError:
        raise
    except Image.DecompressionBombError:
        raise SceneError("the image is too large: make it smaller") from None
    except Exception:  # decoders raise many kinds of errors
        raise SceneError("cannot be read as an image: save it as PNG, JPEG or WebP") from None
    width, height = image.size
    step = -(-max(width, height) // _SIDE_KEPT)
    down, across = min(step, height), min(step, width)
    columns = min(max(1, _TILE // down // across) * across, width)  # by tiles, which fit into the processor's cache
    rows = max(1, _TILE // columns // down) * down

    def tile(top: int, left: int) -> Float[np.ndarray, "h w 4"]:
        part = image.crop((left, top, min(left + columns, width), min(top + rows, height)))
        return _reduced(_decoded(np.asarray(part.convert("RGBA")), color), down, across)

    strips = [
        np.concatenate([tile(top, left) for left in range(0, width, columns)], 1) for top in range(0, height, rows)
    ]
    return np.concatenate(strips), width * height


def _opened(file: io.BufferedIOBase) -> Image.Image:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # bounded before it is decoded
        return Image.open(file, formats=_FORMATS)


def _too_many_pixels() -> SceneError:
    return SceneError(f"its textures have more than {_MAX_PIXELS_OF_A_FILE:,} pixels: make them smaller")


def _decoded(values: np.ndarray, color: bool) -> np.ndarray:
    decoded = (_LINEAR if color else _PLAIN)[values]  # np.take would need four times as long
    decoded[..., 3] = _PLAIN[values[..., 3]]
    return decoded


def _reduced(pixels: np.ndarray, down: int, across: int) -> np.ndarray:
    """Average blocks of down × across pixels; the last row and column are repeated to complete theirs."""
    if down == across == 1:
        return pixels
    height, width = pixels.shape[:2]
    if height % down or width % across:
        pixels = np.pad(pixels, ((0, -height % down), (0, -width % across), (0, 0)), mode="edge")
    rows = _sums(pixels, down)
    return _sums(rows.swapaxes(0, 1), across).swapaxes(0, 1) * np.float32(1 / (down * across))


def _sums(rows: np.ndarray, count: int) -> np.ndarray:
    """Return the sums of every `count` rows, in slices while these are few: whole rows lie together in memory."""
    if count > _SLICES:
        return np.add.reduceat(rows, np.arange(0, len(rows), count), axis=0)
    return sum(rows[i::count] for i in range(count))
