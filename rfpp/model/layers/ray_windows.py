"""Windows of the decoder's self-attention between the ray tokens of a view."""

from __future__ import annotations

import numpy as np
import torch

from rfpp.model.layers.attention import AttentionPattern
from rfpp.segments import Segments, on_device


class WholeView:
    """Every ray token attends to every other of its view."""

    def __call__(self, views: int, rows: int, columns: int, device: torch.device) -> tuple[AttentionPattern, ...]:
        """Return the patterns for N views of rows × columns patches, used by the layers in turn."""
        return (AttentionPattern(Segments.from_lengths([rows * columns] * views, device), recurring=True),)


class ShiftedWindows:
    """Tokens attend within windows of the patch grid, shifted by half their size in every second layer.

    RenderFormer's swin variant uses these windows (after Liu et al., "Swin Transformer", 2021). Windows at the border
    of a shifted grid are smaller, which is equivalent to masking a cyclic shift.

    Args:
        size: Patches along a window's side.
    """

    def __init__(self, size: int):
        self.size = size

    def __call__(self, views: int, rows: int, columns: int, device: torch.device) -> tuple[AttentionPattern, ...]:
        return tuple(self._pattern(views, rows, columns, shift, device) for shift in (0, self.size // 2))

    def _pattern(self, views: int, rows: int, columns: int, shift: int, device: torch.device) -> AttentionPattern:
        down, along = (_windows(n, self.size, shift) for n in (rows, columns))
        window = (down[:, None] * (along[-1] + 1) + along).ravel()
        window = (np.arange(views)[:, None] * (window.max() + 1) + window).ravel()
        order = on_device(np.argsort(window, kind="stable"), device)
        return AttentionPattern(Segments.from_lengths(np.bincount(window).tolist(), device), order=order)


def _windows(count: int, size: int, shift: int) -> np.ndarray:
    """Return the window [count] that each position along an axis lies in."""
    window: np.ndarray = (np.arange(count) + (size - shift) % size) // size
    return window - int(window[0])
