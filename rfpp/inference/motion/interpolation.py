"""Curves through keys: functions of time that are constant before the first key and after the last."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from rfpp.errors import SceneError

Times = Sequence[float | int]
Keys = Sequence | np.ndarray
Values = Float[np.ndarray, "*shape"]
Curve = Callable[[float | int], Values]


def spline(times: Times, values: Keys) -> Curve:
    """Return a Catmull-Rom spline for unequal times, for positions; it may overshoot."""
    return _curve(times, values, lambda t, v: CubicHermiteSpline(t, v, np.gradient(v, t, axis=0)))


def monotone(times: Times, values: Keys) -> Curve:
    """Return a smooth curve between the values of neighboring keys (PCHIP), for sizes, angles and materials."""

    def interpolate(times: Times, values: Values) -> Curve:
        curve, low, high = PchipInterpolator(times, values, axis=0), values.min(axis=0), values.max(axis=0)
        return lambda time: np.clip(curve(time), low, high)  # against rounding

    return _curve(times, values, interpolate)


def slerp(times: Times, degrees: Keys) -> Curve:
    """Return rotations in the convention of `Transform.rotation`, about one axis from key to key.

    Raises SceneError for changes of 180 degrees or more, for which the shortest rotation is not the intended one.
    """

    def interpolate(times: Times, degrees: Values) -> Curve:
        far = np.abs(np.diff(degrees, axis=0)).max(axis=1) >= 180
        if far.any():
            key = int(np.argmax(far))
            between = f"from time {times[key]:g} to {times[key + 1]:g}"
            raise SceneError(f"rotation: an angle changes by 180 degrees or more {between}: add a key between them")
        rotations = Slerp(times, Rotation.from_euler("xyz", degrees, degrees=True))

        def angles(time: float | int) -> Float[np.ndarray, " 3"]:
            with warnings.catch_warnings(action="ignore"):  # of gimbal lock, where any solution is correct
                return rotations(time).as_euler("xyz", degrees=True)

        return angles

    return _curve(times, degrees, interpolate)


def _curve(times: Times, values: Keys, interpolate: Callable[[Times, Values], Curve]) -> Curve:
    values = np.asarray(values, np.float64)
    if len(times) == 1:
        return lambda time: values[0]
    curve = interpolate(times, values)
    return lambda time: curve(min(max(time, times[0]), times[-1]))
