"""Flicker: error of the frame-to-frame changes of a predicted animation."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float

from rfpp.imaging.radiance import perceptual

Frames = Iterable[Float[np.ndarray, "h w 3"]]


def flicker(predictions: Frames, references: Frames) -> float:
    """Compute Σ|Δp − Δr| / Σ|Δr|, the error of changes between consecutive frames relative to the reference's changes.

    p and r are clamp(log2(1 + I), 0, 1) of predicted and reference radiance, and Δ is the difference between a frame
    and the one before. The sums cover all pixels, colors and pairs of frames. 0 means that all changes are correct,
    regardless of constant errors; a still image scores 1. Noise in the reference counts as change. The result is
    infinite if the reference never changes, or NaN if the prediction does not change either.

    Args:
        predictions: Linear radiance of the frames, read two at a time.
        references: Linear radiance of the same frames, read two at a time.
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
