"""Loops over points and rays, compiled: NumPy would write all fifty numbers of each ray to memory."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from hashlib import blake2b
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np

P = ParamSpec("P")
R = TypeVar("R")

#: To 64 bits: float() and int() of a compiled loop leave numbers as they are. NumPy 1 types neither as float or int.
float64 = cast(Callable[[Any], float], np.float64)
int64 = cast(Callable[[Any], int], np.int64)
#: Of all files of loops together.
_SOURCES = blake2b(b"".join(file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py")))).hexdigest()


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The function as machine code, by Numba: on the first call, then kept on disk.

    It holds no lock while it runs, so that the network can compute beside it. Divisions by zero are infinite, as in
    NumPy. It can make no arrays: Numba then counts no references either, which took more than half of the time of loops
    that pass a scene's arrays from function to function, and more with two threads, which wait for each other's counts.
    What it calls becomes part of it: a call passes a hundred numbers, the pointers and sizes of these arrays, on the
    stack, which took a fifth to a third of the time.
    """
    how: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False, "forceinline": True}
    faster: Any = numba.njit(**how)(inspect.unwrap(function))
    if hasattr(faster, "_cache"):  # not where NUMBA_DISABLE_JIT leaves functions as they are
        kept = faster._cache._cache_file  # Numba looks for changes in a function's own file, not in what it calls
        kept._source_stamp = (kept._source_stamp, _SOURCES)
    return cast(Callable[P, R], faster)  # Numba's decorator has no types
