"""Loops over points and rays, compiled: NumPy would write all fifty numbers of each ray to memory."""

from __future__ import annotations

import inspect
from collections.abc import Callable

import numba


def compiled(function: Callable) -> Callable:
    """The function as machine code, by Numba: on the first call, then kept on disk.

    It holds no lock while it runs, so that the network can compute beside it. Divisions by zero are infinite, as in
    NumPy.
    """
    return numba.njit(cache=True, nogil=True, error_model="numpy")(inspect.unwrap(function))
