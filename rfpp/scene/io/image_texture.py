"""Pictures of textures, and their means over triangles."""

from __future__ import annotations

import contextlib
import io
import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable
from functools import cache, cached_property
from typing import Literal

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
_ROUNDING = 0.01  # pixels by which a part may be larger than a number of them
_SIDE = 6  # parts along a triangle's side at most: 36 equal ones, each looked up at its center
_CHUNK = 50_000  # triangles at a time: 45 MB
_UNIFORM = 0.01  # standard deviation below which texels are omitted

#: 8-bit sRGB → linear.
_LINEAR = np.where(
    np.arange(256) <= 0.04045 * 255, np.arange(256) / 255 / 12.92, ((np.arange(256) / 255 + 0.055) / 1.055) ** 2.4
).astype(np.float32)

_PLAIN = (np.arange(256) / 255).astype(np.float32)


#: What is beyond a picture's edge: its other edge, its own edge, or its mirror image.
Wrap = Literal["repeat", "clamp", "mirror"]


class ImageTexture:
    """Image as a mip map.

    Attributes:
        pixels: Number of pixels in its file.

    Args:
        content: Image file.
        color: The image holds sRGB color, which is made linear; else plain numbers.
        left: Pixels that the scene may still load.
        wrap: What is beyond its edges in u and in v.

    Raises:
        SceneError: If the image is damaged or too large; without the file's name.
    """

    def __init__(
        self, content: bytes, color: bool, left: int = _MAX_PIXELS, wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    ) -> None:
        picture, self.pixels = _pixels(content, color, left)
        self._levels, self._wrap = _mip_map(picture), wrap

    @cached_property
    def _squares(self) -> list[np.ndarray]:
        """Mip map of the squares, for spreads."""
        return _mip_map(np.square(self._levels[0], dtype=np.float32))

    def means(self, uv: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, "f 4"]:
        """Return red, green, blue and alpha of each triangle; (0, 0) is the image's upper left corner."""
        return _means(self._levels, uv, self._wrap)

    def pixels_along(self, uv: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, " f"]:
        """Return the number of pixels along each triangle; 0 where the picture hardly varies."""
        height, width = self._levels[0].shape[:2]
        return np.where((self.spreads(uv) > _UNIFORM).any(axis=1), _extent(uv, width, height), 0)

    def spreads(self, uv: Float[np.ndarray, "f 3 2"]) -> Float[np.ndarray, "f 4"]:
        """Return the standard deviation of these within each triangle."""
        return np.sqrt(np.maximum(_means(self._squares, uv, self._wrap) - self.means(uv) ** 2, 0))


class Textures:
    """Textures of one scene file, with a cache of the last used."""

    def __init__(self) -> None:
        self._seen: set[Hashable] = set()
        self._kept: OrderedDict[Hashable, ImageTexture] = OrderedDict()
        self._pixels = 0

    @property
    def used(self) -> int:
        """Number of different textures."""
        return len(self._seen)

    def get(
        self,
        name: Hashable,
        color: bool,
        read: Callable[[], bytes],
        wrap: tuple[Wrap, Wrap] = ("repeat", "repeat"),
    ) -> ImageTexture:
        """Return the texture decoded from the bytes of `read`. Raises SceneError like `ImageTexture`."""
        key = name, color, wrap
        if key not in self._kept:
            texture = ImageTexture(read(), color, _MAX_PIXELS_OF_A_FILE - self._pixels, wrap)
            self._pixels += texture.pixels
            self._seen.add((name, color))
            self._kept[key] = texture
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


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


def _means(
    levels: list[np.ndarray], uv: Float[np.ndarray, "f 3 2"], wrap: tuple[Wrap, Wrap]
) -> Float[np.ndarray, "f 4"]:
    parts = [_means_of_some(levels, uv[i : i + _CHUNK], wrap) for i in range(0, len(uv), _CHUNK)]
    return np.concatenate([np.empty((0, 4), np.float32), *parts])


def _means_of_some(
    levels: list[np.ndarray], uv: Float[np.ndarray, "f 3 2"], wrap: tuple[Wrap, Wrap]
) -> Float[np.ndarray, "f 4"]:
    height, width = levels[0].shape[:2]
    extent = _extent(uv, width, height)
    level = np.minimum(np.floor(np.log2(np.maximum(extent / _SIDE, 1))), len(levels) - 1).astype(int)
    side = np.clip(np.ceil(extent - _ROUNDING), 1, _SIDE).astype(int)  # where few pixels are covered, few are read
    kind, result = level * (_SIDE + 1) + side, np.empty((len(uv), 4), np.float32)
    for number in np.unique(kind).tolist():
        chosen, (level_read, cells) = kind == number, divmod(number, _SIDE + 1)
        pixels = levels[level_read]
        size = np.array([pixels.shape[1], pixels.shape[0]])
        points = _wrapped(_centers(cells) @ uv[chosen], wrap)
        x, y = np.moveaxis(np.minimum(np.floor(points * size), size - 1).astype(int), -1, 0)
        result[chosen] = pixels[y, x].mean(axis=1, dtype=np.float32) if cells > 1 else pixels[y[:, 0], x[:, 0]]
    return result


def _wrapped(points: Float[np.ndarray, "*n 2"], wrap: tuple[Wrap, Wrap]) -> Float[np.ndarray, "*n 2"]:
    """Return points within the picture, from 0 to 1."""
    if wrap == ("repeat", "repeat"):
        return points % 1.0
    within = {"repeat": lambda x: x % 1.0, "clamp": lambda x: np.clip(x, 0, 1), "mirror": lambda x: 1 - abs(x % 2 - 1)}
    return np.stack([within[how](points[..., axis]) for axis, how in enumerate(wrap)], axis=-1)


def _extent(uv: Float[np.ndarray, "f 3 2"], width: int, height: int) -> Float[np.ndarray, " f"]:
    """Return the number of pixels along each triangle."""
    a, b, c = np.moveaxis(uv, 1, 0)
    along = np.maximum(np.maximum(a, b), c) - np.minimum(np.minimum(a, b), c)
    return np.maximum(along[:, 0] * width, along[:, 1] * height)


@cache
def _centers(side: int) -> Float[np.ndarray, "n 3"]:
    """Return barycentric coordinates [side²] of the centers of a triangle's equal parts."""
    cells = [(i, j) for i in range(side) for j in range(side - i)]
    upright = [(i + 1 / 3, j + 1 / 3) for i, j in cells]
    inverted = [(i + 2 / 3, j + 2 / 3) for i, j in cells if i + j < side - 1]
    u, v = np.array(upright + inverted).T / side
    return np.stack([1 - u - v, u, v], axis=1)


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
