"""Digests of arrays and bytes: keys of caches and of stored frames."""

from __future__ import annotations

from hashlib import blake2b

import numpy as np


def digest_of(*parts: np.ndarray | bytes) -> bytes:
    """Return 16 bytes that identify the content and length of each part."""
    digest = blake2b(digest_size=16)
    for part in parts:
        content = memoryview(np.ascontiguousarray(part)).cast("B") if isinstance(part, np.ndarray) else part
        digest.update(len(content).to_bytes(8, "little"))
        digest.update(content)
    return digest.digest()
