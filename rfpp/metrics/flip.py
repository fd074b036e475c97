"""HDR-ꟻLIP: perceived difference between two images that are shown alternately."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

import numpy as np
from jaxtyping import Float

from rfpp.errors import MissingDependencyError

#: Rec. 709 luminance.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
#: Exposures around 0 stops, for references of one brightness.
_UNGUIDED = {"startExposure": -1.0, "stopExposure": 1.0, "numExposures": 3}


def flip(prediction: Float[np.ndarray, "h w 3"], reference: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w"]:
    """Compute the error of each pixel of linear radiance, from 0 (invisible) to 1; the image's ꟻLIP is their mean.

    Andersson et al. 2021, by their package `flip-evaluator`: the largest ꟻLIP over a range of exposures (ACES tone
    map) derived from the reference's luminance, at 67 pixels per degree. A non-finite pixel has error 1.

    Raises:
        MissingDependencyError: If the library is not installed.
    """
    images = (np.ascontiguousarray(image, dtype=np.float32) for image in (reference, prediction))
    # the library exits the process if the range of exposures is empty, as in an image of one brightness
    luminance = reference @ _LUMINANCE
    guided = luminance.max() > 1.001 * np.median(luminance)
    error, _, _ = flip_library().evaluate(
        *images, "HDR", inputsRGB=False, applyMagma=False, parameters={} if guided else dict(_UNGUIDED)
    )
    undefined = ~(np.isfinite(prediction) & np.isfinite(reference)).all(axis=-1)
    return np.where(undefined, np.float32(1), error[..., 0])


def flip_library() -> ModuleType:
    """Import the library that `flip` needs. Raises MissingDependencyError if it is not installed."""
    try:
        return import_module("flip_evaluator")
    except ImportError as error:
        raise MissingDependencyError(f"FLIP needs its library ({error}): pip install 'rfpp[evaluation]'") from None
