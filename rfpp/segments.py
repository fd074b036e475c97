"""Segments: packed sequences of different lengths, without padding between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Int
from torch import Tensor


def on_device(array: np.ndarray, device: torch.device | str) -> Tensor:
    """Return a host array as a tensor on a device, without waiting for the work that the device has queued.

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
    """A partition of the rows of a packed axis into consecutive runs (CSR offsets).

    `total` and `longest` are on the host, so that planning an attention never waits for the device. They are bounds
    where batches are padded to common sizes (see `RaggedBatch.padded`): one CUDA graph then serves them all.

    Attributes:
        offsets: [n + 1] int32, first 0.
        total: Rows; those after the last run belong to none.
        longest: Maximum length of a run, or more.
        host_lengths: The n run lengths, where the host knows them.
        unowned: Whether there may be rows after the last run.
    """

    offsets: Int[Tensor, " n_plus_1"]
    total: int
    longest: int
    host_lengths: tuple[int, ...] | None = None
    unowned: bool = False

    @classmethod
    def from_lengths(cls, lengths: Sequence[int], device: torch.device | str = "cpu") -> Segments:
        offsets = np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)]).astype(np.int32)
        on_host = tuple(int(n) for n in lengths)
        return cls(on_device(offsets, device), int(offsets[-1]), max(on_host, default=0), on_host)

    @classmethod
    def uniform(cls, count: int, length: int, device: torch.device | str = "cpu") -> Segments:
        """Return `count` runs of equal length, created on the device."""
        offsets = length * torch.arange(count + 1, dtype=torch.int32, device=device)
        return cls(offsets, count * length, length, count * (length,))

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @cached_property
    def lengths(self) -> tuple[int, ...]:
        """The n run lengths; waits for the device where the host does not know them."""
        return tuple(self.sizes.tolist()) if self.host_lengths is None else self.host_lengths

    @property
    def sizes(self) -> Int[Tensor, " n"]:
        """[n] int64: the lengths, on the device."""
        return (self.offsets[1:] - self.offsets[:-1]).long()

    @cached_property
    def index(self) -> Int[Tensor, " total"]:
        """[total] int64: the run of each row; the last one for rows that belong to none."""
        rows = torch.arange(self.total, dtype=self.offsets.dtype, device=self.offsets.device)
        return torch.searchsorted(self.offsets[1:], rows, right=True).clamp_(max=len(self) - 1)

    def grouped(self, groups: Segments) -> Segments:
        """Return consecutive runs put together: `groups` are segments of the runs."""
        offsets, lengths = self.offsets[groups.offsets.long()], None
        if self.host_lengths is not None and groups.host_lengths is not None:
            bounds = np.cumsum((0, *self.host_lengths))[np.cumsum((0, *groups.host_lengths))]
            lengths = tuple(np.diff(bounds).tolist())
        return Segments(offsets, self.total, max(lengths) if lengths else self.total, lengths)

    def lengthened(self, by: int) -> Segments:
        """Return the runs with `by` further rows each."""
        more = by * torch.arange(len(self) + 1, dtype=torch.int32, device=self.offsets.device)
        lengths = self.host_lengths and tuple(n + by for n in self.host_lengths)
        return Segments(self.offsets + more, self.total + by * len(self), self.longest + by, lengths)

    def multiplied(self, by: int) -> Segments:
        """Return the runs with `by` rows in place of each row."""
        lengths = self.host_lengths and tuple(n * by for n in self.host_lengths)
        return Segments(self.offsets * by, self.total * by, self.longest * by, lengths)

    def repeated(self, times: int, runs: int) -> Segments:
        """Return the first `runs` runs, each repeated `times` times in succession; `total` is `times` as large."""
        sizes = self.sizes[:runs].repeat_interleave(times, output_size=runs * times)
        offsets = torch.nn.functional.pad(sizes.cumsum(0), (1, 0)).to(self.offsets.dtype)
        lengths = self.host_lengths and tuple(n for n in self.host_lengths[:runs] for _ in range(times))
        return Segments(offsets, self.total * times, self.longest, lengths, unowned=runs < len(self))

    def to(self, device: torch.device | str, **kwargs) -> Segments:
        return replace(self, offsets=self.offsets.to(device, **kwargs))

    def pin_memory(self) -> Segments:
        return replace(self, offsets=self.offsets.pin_memory())
