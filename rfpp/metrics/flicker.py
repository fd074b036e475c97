"""Flicker: error of the frame-to-frame changes of a predicted film."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float

from rfpp.imaging.radiance import perceptual

Frames = Iterable[Float[np.ndarray, "h w 3"]]


def flicker(predictions: Frames, references: Frames) -> float:
    """Σ|Δp − Δr| / Σ|Δr|: the error of the changes between consecutive frames, as a share of the reference's own.

    p and r are clamp(log2(1 + I), 0, 1) of predicted and reference radiance, Δ the difference of a frame from the one
    before, and both sums run over all pixels, colours and pairs of frames. 0 is a film whose every change is right,
    whatever its constant errors; 1 is what a still picture scores; larger is a film that changes where it should not.
    The reference's remaining noise counts as change of its own. Where the reference does not change at all the result
    is infinite, or NaN if the prediction does not change either.

    Args:
        predictions, references: linear radiance of the same frames, in order; read two at a time.
    """
    error = change = 0.0
    frames = zip(map(_tone_mapped, predictions), map(_tone_mapped, references), strict=True)
    for (prediction, reference), (next_prediction, next_reference) in pairwise(frames):
        moved = next_reference - reference
        error += np.abs((next_prediction - prediction) - moved).sum(dtype=np.float64)
        change += np.abs(moved).sum(dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.divide(error, change))


def _tone_mapped(radiance: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    return perceptual(torch.from_numpy(np.asarray(radiance, dtype=np.float32))).numpy()
