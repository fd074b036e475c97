"""Memory allocator settings of the process."""

from __future__ import annotations

import ctypes
import sys

#: glibc's names for its settings, from malloc.h.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_LARGEST = 2**31 - 1


def keep_freed_memory() -> None:
    """Let glibc keep large blocks that were freed, for the next ones of their size.

    By default it returns every block above 32 MB to the system and gets the next one page by page, each page zeroed:
    a third of a network's time on a CPU. The price is fragmentation, a tenth to a fifth more resident memory at its
    peak (data/results/LOG.md). Where the C library is another one nothing happens.
    """
    if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "mallopt"):
        libc.mallopt(_MMAP_THRESHOLD, _LARGEST)
        libc.mallopt(_TRIM_THRESHOLD, _LARGEST)
