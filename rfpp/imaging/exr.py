"""OpenEXR images as named layers: the only file that knows the image library.

A layer is an array [H, W] (one channel: half, float32 or uint32) or [H, W, 3 or 4] (half or float32). The layer
named "RGB" is what image viewers show. Compression is ZIP, which is lossless.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenEXR

from rfpp.errors import UserError
from rfpp.files import write_atomically

HALF_MAX = float(np.finfo(np.float16).max)
_DTYPES = (np.dtype(np.float16), np.dtype(np.float32), np.dtype(np.uint32))


class ImageFileError(UserError):
    """An image file that is missing, truncated or damaged."""


def encode_exr(layers: Mapping[str, np.ndarray], attributes: Mapping[str, str] | None = None) -> bytes:
    """The bytes of an OpenEXR file with these layers (see the module) and text attributes in its header.

    Raises:
        ValueError: no layer, layers of different sizes, or a shape or dtype that the format would store wrongly.
    """
    if len({np.shape(layer)[:2] for layer in layers.values()}) != 1:
        raise ValueError(f"layers must share one height and width, got { {n: np.shape(a) for n, a in layers.items()} }")
    channels = {name: _storable(name, layer) for name, layer in layers.items()}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **(attributes or {})}
    stream = io.BytesIO()
    OpenEXR.File(header, channels).write(stream)
    return stream.getvalue()


def decode_exr(data: bytes, source: str = "EXR data") -> dict[str, np.ndarray]:
    """The layers of an OpenEXR file. Raises ImageFileError naming `source` when the data is truncated or damaged."""
    with _opened(data, source) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def exr_attributes(data: bytes, source: str = "EXR data") -> dict[str, str]:
    """The text attributes in the header, as given to `encode_exr`. Raises ImageFileError like `decode_exr`."""
    with _opened(data, source) as file:
        return {name: value for name, value in file.header().items() if isinstance(value, str)}


def compact(radiance: np.ndarray) -> np.ndarray:
    """Half floats where they hold it, else float32."""
    return np.ascontiguousarray(radiance, np.float16 if np.abs(radiance).max(initial=0) <= HALF_MAX else np.float32)


def write_exr(path: Path, layers: Mapping[str, np.ndarray], attributes: Mapping[str, str] | None = None) -> Path:
    """Write an OpenEXR file atomically, creating its folder; returns the path. Raises UserError (full disk)."""
    return write_atomically(Path(path), encode_exr(layers, attributes))


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """The layers of an OpenEXR file. Raises ImageFileError naming a missing, unreadable or damaged file."""
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise ImageFileError(f"{path}: cannot be read ({error.strerror}): check the path") from error
    return decode_exr(data, str(path))


def _storable(name: str, layer: np.ndarray) -> np.ndarray:
    """`layer`, contiguous. The library writes other layouts and channel counts wrongly without saying so."""
    layer = np.ascontiguousarray(layer)
    if layer.dtype not in _DTYPES:
        raise ValueError(f"layer '{name}' has dtype {layer.dtype}: use float16, float32 or uint32")
    if layer.ndim != 2 and not (layer.ndim == 3 and layer.shape[2] in (3, 4)):
        raise ValueError(f"layer '{name}' has shape {layer.shape}: use [H, W], [H, W, 3] or [H, W, 4]")
    return layer


@contextmanager
def _opened(data: bytes, source: str) -> Iterator[OpenEXR.File]:
    """The parsed file; damaged data appears to the library as an exception or as a file without parts."""
    try:
        file = OpenEXR.File(io.BytesIO(data))
    except Exception as error:
        raise ImageFileError(f"{source}: not a complete OpenEXR image: make or download it again") from error
    with file:
        if not file.parts:
            raise ImageFileError(f"{source}: truncated or damaged OpenEXR image: make or download it again")
        yield file
