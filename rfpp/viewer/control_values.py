"""Validate control values sent by the browser."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

#: Positions and the like, in world units or degrees: nothing that is looked at lies beyond.
_FARTHEST = 1e4


def number(slider: Any) -> float | int:
    """Of a slider, within its ends."""
    return _within(slider.value, slider.min, slider.max)


def choice(dropdown: Any) -> str:
    """Of a dropdown or a group of buttons: one of its options, the first where it is none."""
    return dropdown.value if dropdown.value in dropdown.options else dropdown.options[0]


def vector(handle: Any) -> tuple[float | int, float | int, float | int]:
    """Of three numbers: finite ones."""
    x, y, z = (_within(value, -_FARTHEST, _FARTHEST) for value in _three(handle.value))
    return x, y, z


def colour(picker: Any) -> tuple[int, int, int]:
    """Of a colour picker: 0 to 255."""
    red, green, blue = (round(_within(value, 0, 255)) for value in _three(picker.value))
    return red, green, blue


def _three(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list | tuple) and len(value) == 3 else (0, 0, 0)


def _within(value: Any, low: float | int, high: float | int) -> float | int:
    """The number within these ends; the lower one for what is none."""
    if not isinstance(value, int | float) or value != value:  # NaN; of a huge integer `math.isnan` makes an error
        return low
    return min(max(value, low), high)
