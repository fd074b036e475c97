"""Closed intervals in YAML: validation and uniform sampling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Annotated

import numpy as np
from pydantic import AfterValidator

from rfpp.errors import SceneError


def _ordered(interval: Sequence[float | int]) -> tuple[float | int, ...]:
    if len(interval) != 2 or not interval[0] <= interval[1]:
        raise ValueError(f"{list(interval)} is not an interval: write [low, high] with low <= high")
    return tuple(interval)


#: `[low, high]` with low <= high; samplers store it as a tuple.
Interval = Annotated[Sequence[float | int], AfterValidator(_ordered)]


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
            try:
                value = _ordered(getattr(self, field.name))
            except ValueError as error:
                raise SceneError(f"{type(self).__name__}.{field.name}: {error}") from None
            object.__setattr__(self, field.name, value)
