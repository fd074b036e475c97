"""Read radiance from image files: linear from EXR, or decoded from 8-bit sRGB."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from PIL import Image

from rfpp.errors import UserError
from rfpp.imaging.exr import read_exr
from rfpp.imaging.radiance import linear

#: Of 8 bits, what is no longer measured: white may have been anything brighter.
_CLIPPED = 254
_MAX_PIXELS = 1 << 26
_FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")


def read_radiance(path: Path, stops: float | int = 0.0) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Linear radiance of a picture, and where it is known: neither clipped, nor NaN or infinite.

    Args:
        stops: the exposure that an 8-bit picture was made with; EXR files have none.

    Raises:
        UserError: naming the file: missing, no picture that can be read, or without colours.
    """
    if path.suffix.lower() == ".exr":
        layers = read_exr(path)
        radiance = layers.get("RGB", layers.get("RGBA"))
        if radiance is None:
            raise UserError(f"{path}: has no layer RGB, but {', '.join(sorted(layers)[:4])}: name the picture's file")
        radiance = radiance[..., :3].astype(np.float32)
        known = np.isfinite(radiance).all(-1) & (radiance >= 0).all(-1)
        return np.where(known[..., None], radiance, 0), known
    try:
        with Image.open(path, formats=_FORMATS) as picture:
            if picture.width * picture.height > _MAX_PIXELS:
                raise UserError(f"{path}: has more than {_MAX_PIXELS:,} pixels: make it smaller")
            display = np.asarray(picture.convert("RGB"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        reason = getattr(error, "strerror", None) or "no picture that can be read"
        raise UserError(f"{path}: {reason}: give an EXR file, or a PNG or JPEG file with an sRGB curve") from None
    radiance = linear(torch.from_numpy(display.astype(np.float32) / 255)).numpy() * 2.0**-stops
    return radiance.astype(np.float32), (display < _CLIPPED).all(-1)
