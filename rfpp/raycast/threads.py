"""Compiled loops over many rows, on all of the processor's cores that this process may use.

Between them NumPy multiplies no large matrices (`np.einsum` does without BLAS): OpenBLAS's threads go on spinning for
tens of milliseconds after each product, and take the cores from the loops.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

#: Rows that are not worth a thread of their own.
_FEW = 1 << 11
#: Blocks for each core: those of a sky take less time than those of a mirror.
_BLOCKS = 4


def over_rows(count: int, loop: Callable[..., None], *arguments: Any) -> None:
    """Calls loop(first, last, *arguments) for blocks of rows. What a row comes to must not depend on its block.

    Args:
        loop: compiled, so that it holds no lock (`rfpp.raycast.compiled`).
    """
    blocks = min(_BLOCKS * cores(), -(-count // _FEW)) if cores() > 1 else 1
    if blocks <= 1:
        loop(0, count, *arguments)
        return
    bounds = [count * block // blocks for block in range(blocks + 1)]
    with ThreadPoolExecutor(cores(), "rays") as pool:
        for done in [pool.submit(loop, *bound, *arguments) for bound in pairwise(bounds)]:
            done.result()


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
