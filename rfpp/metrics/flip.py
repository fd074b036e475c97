"""HDR-ꟻLIP: the difference that a person sees when two images are shown in turn."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

import numpy as np
from jaxtyping import Float

from rfpp.errors import MissingDependencyError

#: Rec. 709 luminance.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
#: Stops around 0, for a reference whose own brightness does not say how it would be exposed.
_UNGUIDED = {"startExposure": -1.0, "stopExposure": 1.0, "numExposures": 3}


def flip(prediction: Float[np.ndarray, "h w 3"], reference: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w"]:
    """The error of each pixel, from 0 (none is seen) to 1; the image's ꟻLIP is the mean.

    Andersson et al. 2021, by its authors' `flip-evaluator`: the largest ꟻLIP over a range of exposures (ACES tone map)
    that follows from the reference's luminance, at 67 pixels per degree. A pixel that is not finite has error 1.

    Args:
        prediction, reference: linear radiance.

    Raises:
        MissingDependencyError: the library is not installed.
    """
    images = (np.ascontiguousarray(image, dtype=np.float32) for image in (reference, prediction))
    # The library ends the whole process where the range would be empty: in an image of one brightness.
    luminance = reference @ _LUMINANCE
    guided = luminance.max() > 1.001 * np.median(luminance)
    error, _, _ = flip_library().evaluate(
        *images, "HDR", inputsRGB=False, applyMagma=False, parameters={} if guided else dict(_UNGUIDED)
    )
    undefined = ~(np.isfinite(prediction) & np.isfinite(reference)).all(axis=-1)
    return np.where(undefined, np.float32(1), error[..., 0])


def flip_library() -> ModuleType:
    """The library that `flip` needs. Raises MissingDependencyError."""
    try:
        return import_module("flip_evaluator")
    except ImportError as error:
        raise MissingDependencyError(f"FLIP needs its library ({error}): pip install 'rfpp[evaluation]'") from None
