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


def freeze_intervals(sampler: object) -> None:
    """Check the `Interval` fields of a frozen dataclass and store them as tuples; called in `__post_init__`.

    Raises:
        SceneError: If a field is not two numbers in order; names class and field.
    """
    for field in fields(sampler):  # type: ignore[arg-type]
        if field.type != "Interval":
            continue
        value = tuple(getattr(sampler, field.name))
        if len(value) != 2 or not value[0] <= value[1]:
            name = f"{type(sampler).__name__}.{field.name}"
            raise SceneError(f"{name}: {list(value)} is not an interval: write [low, high] with low <= high")
        object.__setattr__(sampler, field.name, value)
