"""Values of controls as they may be: a browser can send anything, whatever its page offers."""

from __future__ import annotations

import math
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
    x, y, z = (_within(value, -_FARTHEST, _FARTHEST) for value in handle.value)
    return x, y, z


def colour(picker: Any) -> tuple[int, int, int]:
    """Of a colour picker: 0 to 255."""
    red, green, blue = (round(_within(value, 0, 255)) for value in picker.value)
    return red, green, blue


def _within(value: float | int, low: float | int, high: float | int) -> float | int:
    return low if math.isnan(value) else min(max(value, low), high)
