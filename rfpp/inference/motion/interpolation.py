"""Curves through keys: functions of time that hold their first value before the first key and their last after it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from rfpp.errors import SceneError

Times = Sequence[float | int]
Curve = Callable[[float | int], Float[np.ndarray, "*shape"]]


def flowing(times: Times, values: ArrayLike) -> Curve:
    """For places: a Catmull-Rom spline, whose tangents allow for unequal times. It swings out beyond keys in bends."""
    values = np.asarray(values, np.float64)
    if len(times) == 1:
        return lambda time: values[0]
    return _held(CubicHermiteSpline(times, values, np.gradient(values, times, axis=0)), times)


def bounded(times: Times, values: ArrayLike) -> Curve:
    """For sizes, angles of view and materials: smooth, and never outside the two keys around it (PCHIP)."""
    values = np.asarray(values, np.float64)
    if len(times) == 1:
        return lambda time: values[0]
    curve, low, high = PchipInterpolator(times, values, axis=0), values.min(axis=0), values.max(axis=0)
    return _held(lambda time: np.clip(curve(time), low, high), times)  # rounding would leave the keys' range


def turning(times: Times, degrees: ArrayLike) -> Curve:
    """For rotations in the convention of `Transform.rotation`: about one fixed axis from key to key, evenly (slerp).

    Raises:
        SceneError: an angle that changes by 180 degrees or more between two keys, where the shortest way that slerp
            takes is not the one that was meant.
    """
    degrees = np.asarray(degrees, np.float64)
    if len(times) == 1:
        return lambda time: degrees[0]
    far = np.abs(np.diff(degrees, axis=0)).max(axis=1) >= 180
    if far.any():
        key = int(np.argmax(far))
        raise SceneError(
            f"rotation: an angle changes by 180 degrees or more from time {times[key]:g} to {times[key + 1]:g}: "
            "put a key between them"
        )
    rotations = Slerp(times, Rotation.from_euler("xyz", degrees, degrees=True))
    return _held(lambda time: _angles(rotations(time)), times)


def _angles(rotation: Rotation) -> Float[np.ndarray, " 3"]:
    """Angles in degrees about the fixed x, y and z axes in turn.

    Where y is turned by a right angle x and z turn alike, and only their sum matters: SciPy would warn of that.
    """
    matrix = rotation.as_matrix()
    y = np.arcsin(np.clip(-matrix[2, 0], -1, 1))
    if np.hypot(matrix[0, 0], matrix[1, 0]) < 1e-9:
        return np.degrees([0.0, y, np.arctan2(-matrix[0, 1], matrix[1, 1])])
    return np.degrees([np.arctan2(matrix[2, 1], matrix[2, 2]), y, np.arctan2(matrix[1, 0], matrix[0, 0])])


def _held(curve: Curve, times: Times) -> Curve:
    return lambda time: curve(min(max(time, times[0]), times[-1]))
