"""Segments: packed sequences of different lengths, without padding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor


def on_device(array: np.ndarray, device: torch.device | str) -> Tensor:
    """A host array as a tensor there, without waiting for what the device has been asked to do.

    From pageable memory a copy to a GPU waits until all work before it is done.
    """
    tensor = torch.from_numpy(array)
    if torch.device(device).type != "cuda":
        return tensor.to(device)
    if torch.cuda.is_available():  # only shapes are computed otherwise
        tensor = tensor.pin_memory()
    return tensor.to(device, non_blocking=True)


@dataclass(frozen=True)
class Segments:
    """A partition of a packed axis into consecutive runs (CSR offsets).

    The lengths are kept on the host too, so that planning an attention never waits for the device.

    Attributes:
        offsets: [n + 1] int32, first 0.
        lengths: n run lengths.
    """

    offsets: Int[Tensor, " n_plus_1"]
    lengths: tuple[int, ...]

    @classmethod
    def from_lengths(cls, lengths: Sequence[int], device: torch.device | str = "cpu") -> Segments:
        offsets = np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)]).astype(np.int32)
        return cls(on_device(offsets, device), tuple(int(n) for n in lengths))

    def __len__(self) -> int:
        return len(self.lengths)

    @property
    def total(self) -> int:
        return sum(self.lengths)

    @property
    def sizes(self) -> Int[Tensor, " n"]:
        """[n] int64: the lengths, on the device."""
        return (self.offsets[1:] - self.offsets[:-1]).long()

    @cached_property
    def index(self) -> Int[Tensor, " total"]:
        """[total] int64: the segment each row belongs to."""
        segments = torch.arange(len(self), device=self.offsets.device)
        return torch.repeat_interleave(segments, self.sizes, output_size=self.total)

    def grouped(self, groups: Segments) -> Segments:
        """Consecutive runs put together: `groups` are segments of the runs."""
        bounds = np.concatenate([[0], np.cumsum(groups.lengths)])
        lengths = (sum(self.lengths[a:b]) for a, b in pairwise(bounds))
        return Segments(self.offsets[groups.offsets.long()], tuple(lengths))

    def lengthened(self, by: int) -> Segments:
        """Every run with so many more rows."""
        more = by * torch.arange(len(self) + 1, dtype=torch.int32, device=self.offsets.device)
        return Segments(self.offsets + more, tuple(n + by for n in self.lengths))

    def to(self, device: torch.device | str, **kwargs) -> Segments:
        return Segments(self.offsets.to(device, **kwargs), self.lengths)

    def pin_memory(self) -> Segments:
        return Segments(self.offsets.pin_memory(), self.lengths)
