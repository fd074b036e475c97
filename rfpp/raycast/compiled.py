"""Loops over points and rays, compiled by Numba: NumPy would write all fifty numbers of each ray to memory."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np

P = ParamSpec("P")
R = TypeVar("R")

#: Convert to 64 bits: float() and int() leave numbers in a compiled loop as they are. NumPy 1 has no types for these.
float64 = cast(Callable[[Any], float], np.float64)
int64 = cast(Callable[[Any], int], np.int64)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function on its first call and cache the machine code on disk.

    The function releases the GIL and cannot allocate arrays, so that Numba counts no references (more than half of the
    time of loops that pass a scene's arrays to other functions). Calls are inlined, because each would pass a hundred
    numbers on the stack. Divisions by zero are infinite, as in NumPy.
    """
    how: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False, "forceinline": True}
    source = inspect.unwrap(function)
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = before or _cache_folder(Path(inspect.getfile(source)).parent)
    try:
        faster: Any = numba.njit(**how)(source)
    finally:
        config.CACHE_DIR = before
    return cast(Callable[P, R], faster)  # Numba's decorator has no types


def announce_compilation(say: Callable[[str], object]) -> None:
    """Say that the ray loops are about to be compiled, unless machine code of this version is on disk."""
    config: Any = numba.config
    if not any(Path(config.CACHE_DIR or _cache_folder(Path(__file__).parent)).rglob("*.nbc")):
        say("Compiling the ray loops, once per version: up to a minute …")


@cache
def _cache_folder(package: Path) -> str:
    """Return a cache folder for the current sources.

    Numba notices changes in a function's own file only, not in the functions that are inlined into it.
    """
    sources = sorted({*package.glob("*.py"), *Path(__file__).parent.glob("*.py")})
    digest = blake2b(b"".join(file.read_bytes() for file in sources), digest_size=8).hexdigest()
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return str(root / "rfpp" / "numba" / digest)
