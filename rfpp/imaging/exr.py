"""OpenEXR images as named layers: the only file that uses the image library.

A layer is an array [H, W] (one channel: half, float32 or uint32) or [H, W, 3 or 4] (half or float32). Image viewers
show the layer named "RGB". Compression is ZIP, which is lossless.
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
    """Return an OpenEXR file with layers of one size and text attributes. Raises ValueError if it cannot store them."""
    if len({np.shape(layer)[:2] for layer in layers.values()}) != 1:
        raise ValueError(f"layers must share one height and width, got { {n: np.shape(a) for n, a in layers.items()} }")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **(attributes or {})}
    stream = io.BytesIO()
    OpenEXR.File(header, {name: _storable(name, layer) for name, layer in layers.items()}).write(stream)
    return stream.getvalue()


def decode_exr(data: bytes, source: str = "EXR data") -> dict[str, np.ndarray]:
    """Return the layers of an OpenEXR file. Raises ImageFileError naming `source` if it is damaged."""
    with _opened(data, source) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def exr_attributes(data: bytes, source: str = "EXR data") -> dict[str, str]:
    """Return the text attributes in the header. Raises ImageFileError naming `source` if the file is damaged."""
    with _opened(data, source) as file:
        return {name: value for name, value in file.header().items() if isinstance(value, str)}


def compact(radiance: np.ndarray) -> np.ndarray:
    """Return half floats if they can hold the values, otherwise float32."""
    return np.ascontiguousarray(radiance, np.float16 if np.abs(radiance).max(initial=0) <= HALF_MAX else np.float32)


def write_exr(path: Path, layers: Mapping[str, np.ndarray], attributes: Mapping[str, str] | None = None) -> Path:
    """Write an OpenEXR file atomically and return its path. Raises UserError if it cannot be written."""
    return write_atomically(Path(path), encode_exr(layers, attributes))


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Return the layers of an OpenEXR file. Raises ImageFileError if it is missing or damaged."""
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise ImageFileError(f"{path}: cannot be read ({error.strerror}): check the path") from error
    return decode_exr(data, str(path))


def _storable(name: str, layer: np.ndarray) -> np.ndarray:
    """Return a contiguous layer; the library silently corrupts other layouts and channel counts."""
    layer = np.ascontiguousarray(layer)
    if layer.dtype not in _DTYPES:
        raise ValueError(f"layer '{name}' has dtype {layer.dtype}: use float16, float32 or uint32")
    if layer.ndim != 2 and not (layer.ndim == 3 and layer.shape[2] in (3, 4)):
        raise ValueError(f"layer '{name}' has shape {layer.shape}: use [H, W], [H, W, 3] or [H, W, 4]")
    return layer


@contextmanager
def _opened(data: bytes, source: str) -> Iterator[OpenEXR.File]:
    """Open a file; the library reports damage by exceptions of several kinds, or by a file without parts."""
    try:
        file = OpenEXR.File(io.BytesIO(data))
        if not file.parts:
            raise ValueError("no parts")
    except Exception as error:
        raise ImageFileError(f"{source}: not a complete OpenEXR image: create or download it again") from error
    with file:
        yield file
