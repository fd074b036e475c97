"""Counter-based random numbers: functions of a key and a number, independent of the order of use."""

from __future__ import annotations

import numpy as np

from rfpp.raycast.compiled import compiled, float64
from rfpp.raycast.vectors import GOLDEN

#: Seed of a stream of numbers.
Key = int | np.uint64
#: Odd constants of SplitMix64 (Steele et al., "Fast Splittable Pseudorandom Number Generators", 2014).
_STEP, _FIRST, _SECOND = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB

#: Pixels along each side of a tile.
TILE = 4


@compiled
def key_of(key: Key, number: int) -> np.uint64:
    """Derive a key from a key and a number."""
    z = np.uint64(key) + np.uint64(number) * np.uint64(_STEP) + np.uint64(_STEP)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(_FIRST)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(_SECOND)
    return z ^ (z >> np.uint64(31))


@compiled
def uniform(key: Key, number: int) -> float:
    """Return a number in [0, 1)."""
    return float64(key_of(key, number) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@compiled
def spread(count: int, shift_u: float, shift_v: float) -> tuple[float, float]:
    """Return a point of an even sequence in the unit square (Roberts 2018), displaced by the shift."""
    return (0.5 + count * 0.7548776662466927 + shift_u) % 1, (0.5 + count * 0.5698402909980532 + shift_v) % 1


@compiled
def tile_of(pixel: int, width: int) -> tuple[int, int]:
    """Return a pixel's tile and its place there."""
    y, x = pixel // width, pixel % width
    return y // TILE * width + x // TILE, y % TILE * TILE + x % TILE


@compiled
def shift_of(key: Key, pixel: int, width: int) -> tuple[float, float]:
    """Return a pixel's displacement of an even sequence; those of a tile are even, too."""
    tile, place = tile_of(pixel, width)
    of_tile = key_of(key, tile)
    return uniform(of_tile, 0) + place * GOLDEN, uniform(of_tile, 1) + place / (TILE * TILE)
