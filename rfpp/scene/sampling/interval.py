"""Closed intervals: validation and uniform sampling of ranges in YAML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from rfpp.errors import SceneError

#: `[low, high]` with low <= high. Samplers store it as a tuple, whatever sequence the configuration gave.
Interval = Sequence[float | int]


def uniform(rng: np.random.Generator, interval: Interval, size: int | tuple[int, ...] | None = None):
    """A uniform draw from the interval: a float, or an array of the given size."""
    low, high = interval
    return rng.uniform(low, high, size)


def uniform_integer(rng: np.random.Generator, interval: Interval) -> int:
    """A uniform integer draw, both ends included."""
    low, high = interval
    return int(rng.integers(low, high, endpoint=True))


def freeze_intervals(sampler: object) -> None:
    """Check the `Interval` fields of a frozen dataclass and store them as tuples; call it in `__post_init__`.

    Raises:
        SceneError: naming class and field, if one is not two numbers in order.
    """
    for field in fields(sampler):  # type: ignore[arg-type]
        if field.type != "Interval":
            continue
        value = tuple(getattr(sampler, field.name))
        if len(value) != 2 or not value[0] <= value[1]:
            name = f"{type(sampler).__name__}.{field.name}"
            raise SceneError(f"{name}: {list(value)} is no interval: write [low, high] with low <= high")
        object.__setattr__(sampler, field.name, value)
