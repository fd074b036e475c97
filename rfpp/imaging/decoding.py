"""Read radiance from image files: linear from EXR, decoded from 8-bit sRGB."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from PIL import Image

from rfpp.errors import UserError
from rfpp.imaging.exr import read_exr
from rfpp.imaging.radiance import linear

#: Brightest 8-bit value that is not clipped.
_CLIPPED = 254


def read_radiance(path: Path, stops: float | int = 0.0) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Return the linear radiance of an EXR, PNG or JPEG file, and a mask of pixels that are finite and not clipped.

    8-bit pictures were exposed by `stops`. Raises UserError if the file is missing or not such a picture.
    """
    if path.suffix.lower() == ".exr":
        layers = read_exr(path)
        radiance = layers.get("RGB", layers.get("RGBA"))
        if radiance is None:
            raise UserError(f"{path}: has no layer RGB, but {', '.join(sorted(layers)[:4])}: choose another file")
        radiance = radiance[..., :3].astype(np.float32)
        is_valid = np.isfinite(radiance).all(-1) & (radiance >= 0).all(-1)
        return np.where(is_valid[..., None], radiance, 0), is_valid
    try:
        with Image.open(path, formats=("PNG", "JPEG")) as picture:
            display = np.asarray(picture.convert("RGB"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        reason = getattr(error, "strerror", None) or "not a readable picture"
        raise UserError(f"{path}: {reason}: give an EXR file, or a PNG or JPEG file with an sRGB curve") from None
    radiance = linear(torch.from_numpy(display.astype(np.float32) / 255)).numpy() * 2.0**-stops
    return radiance.astype(np.float32), (display < _CLIPPED).all(-1)
