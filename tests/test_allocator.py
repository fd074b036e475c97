"""A freed block of memory is reused for the next one."""

import resource
import sys

import pytest
import torch

from rfpp.allocator import keep_freed_memory

BLOCK = 100_000_000


def page_faults_of_a_block() -> int:
    """Count the pages that the system hands out for a block that is used and freed."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    torch.ones(BLOCK // 4)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc has the setting")
def test_a_freed_block_is_reused():
    keep_freed_memory()
    assert [page_faults_of_a_block() for _ in range(10)][-1] < 0.1 * BLOCK / resource.getpagesize()
