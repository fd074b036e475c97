"""Closed intervals in YAML: validation and uniform sampling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from rfpp.errors import SceneError

#: `[low, high]` with low <= high; samplers store it as a tuple.
Interval = Sequence[float | int]


def uniform(rng: np.random.Generator, interval: Interval, size: int | tuple[int, ...] | None = None):
    """Draw uniformly from the interval: a float, or an array of the given size."""
    low, high = interval
    return rng.uniform(low, high, size)


def uniform_integer(rng: np.random.Generator, interval: Interval) -> int:
    """Draw a uniform integer, including both ends."""
    low, high = interval
    return int(rng.integers(low, high, endpoint=True))


class HasIntervals:
    """Base class of frozen dataclasses that checks their `Interval` fields and stores them as tuples.

    Raises:
        SceneError: If a field is not two numbers in order; names class and field.
    """

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            if field.type != "Interval":
                continue
            value = tuple(getattr(self, field.name))
            if len(value) != 2 or not value[0] <= value[1]:
                name = f"{type(self).__name__}.{field.name}"
                raise SceneError(f"{name}: {list(value)} is not an interval: write [low, high] with low <= high")
            object.__setattr__(self, field.name, value)
