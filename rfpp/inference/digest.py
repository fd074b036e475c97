"""Arrays by what is in them: keys of what is kept."""

from __future__ import annotations

from hashlib import blake2b

import numpy as np


def digest_of(*arrays: np.ndarray) -> bytes:
    """16 bytes that no other arrays of these shapes have."""
    digest = blake2b(digest_size=16)
    for array in arrays:
        digest.update(np.ascontiguousarray(array))
    return digest.digest()
