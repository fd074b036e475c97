"""Run compiled loops over many rows on all available cores.

Code between the loops avoids BLAS (`np.einsum` does): OpenBLAS's threads spin for tens of milliseconds after each
product and take the cores from the loops.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

#: Rows too few for a thread of their own.
_FEW = 1 << 11
#: Blocks per core; blocks of background take less time than blocks of mirrors.
_BLOCKS = 4


def over_rows(count: int, loop: Callable[..., None], *arguments: Any) -> None:
    """Call loop(first, last, *arguments) for blocks of rows. Results must not depend on the blocks.

    Args:
        loop: Compiled function, which holds no lock (`rfpp.raycast.compiled`).
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
    """Return the number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
