"""Windows of the decoder's self-attention between the ray tokens of a view."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from rfpp.model.layers.attention import AttentionPattern
from rfpp.ranges import Positive
from rfpp.segments import Segments

Positions = TypeVar("Positions", np.ndarray, Tensor)


class WholeView:
    """Every ray token attends to every other of its view."""

    def __call__(self, views: int, rows: int, columns: int, device: torch.device) -> tuple[AttentionPattern, ...]:
        """Return the patterns for N views of rows × columns patches, used by the layers in turn."""
        rays = rows * columns
        return (AttentionPattern(Segments.uniform(views, rays, device), equal_length=rays),)


class ShiftedWindows:
    """Tokens attend within windows of the patch grid, shifted by half their size in every second layer.

    RenderFormer's swin variant uses these windows (after Liu et al., "Swin Transformer", 2021). Windows at the border
    of a shifted grid are smaller, which is equivalent to masking a cyclic shift.

    Args:
        size: Patches along a window's side.
    """

    def __init__(self, size: Positive):
        self.size = size

    def __call__(self, views: int, rows: int, columns: int, device: torch.device) -> tuple[AttentionPattern, ...]:
        return tuple(self._pattern(views, rows, columns, shift, device) for shift in (0, self.size // 2))

    def _pattern(self, views: int, rows: int, columns: int, shift: int, device: torch.device) -> AttentionPattern:
        counts = [np.bincount(_windows(np.arange(n), self.size, shift)) for n in (rows, columns)]
        lengths = views * np.outer(*counts).ravel().tolist()
        # made on the device: a CUDA graph must not copy from the host
        down, along = (_windows(torch.arange(n, device=device), self.size, shift) for n in (rows, columns))
        view = torch.arange(views, device=device)[:, None, None]
        window = ((view * len(counts[0]) + down[:, None]) * len(counts[1]) + along).flatten()
        order = window.argsort(stable=True)
        ends = torch.searchsorted(window[order], torch.arange(len(lengths) + 1, device=device), out_int32=True)
        return AttentionPattern(Segments(ends, sum(lengths), max(lengths), tuple(lengths)), order=order)


def _windows(positions: Positions, size: int, shift: int) -> Positions:
    """Return the window of each position along an axis."""
    start = (size - shift) % size
    return (positions + start) // size - start // size
