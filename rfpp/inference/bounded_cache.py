"""A cache with a limit in bytes that discards the least recently used values, and digests as its keys."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import fields, is_dataclass
from hashlib import blake2b
from threading import Lock
from typing import Generic, TypeVar

import numpy as np
from cachetools import LRUCache

Value = TypeVar("Value")


class BoundedCache(Generic[Value]):
    """Thread-safe cache with a limit of all values together."""

    def __init__(self, max_bytes: int):
        self._entries: LRUCache = LRUCache(max_bytes, getsizeof=lambda entry: entry[1])
        self._lock = Lock()
        self._computing: dict[Hashable, Lock] = {}

    def get(self, key: Hashable) -> Value | None:
        """Return a value, or None if it is not in the cache."""
        with self._lock:
            return self._entries.get(key, (None, 0))[0]

    def put(self, key: Hashable, value: Value, size: int) -> None:
        """Store a value of `size` bytes, unless it exceeds the limit by itself."""
        with self._lock, suppress(ValueError):  # raised for values above the limit
            self._entries[key] = value, size

    def get_or_compute(self, key: Hashable, size: int | None, compute: Callable[[], Value]) -> Value:
        """Return a value; compute and store it first if it is missing.

        Threads that request the same value wait for one of them to compute it. `compute` may use other keys only.

        Args:
            size: Bytes of the value; None for those of its arrays.
        """
        with self._lock:
            computing = self._computing.setdefault(key, Lock())
        try:
            with computing:
                value = self.get(key)
                if value is None:
                    value = compute()
                    self.put(key, value, bytes_of(value) if size is None else size)
                return value
        finally:
            with self._lock:
                self._computing.pop(key, None)


def bytes_of(value: object) -> int:
    """Return the size of all arrays in a dataclass, or in a tuple of them."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    if is_dataclass(value):
        return sum(bytes_of(getattr(value, field.name)) for field in fields(value))
    return sum(map(bytes_of, value)) if isinstance(value, tuple) else 0


def digest_of(*parts: np.ndarray | bytes) -> bytes:
    """Return 16 bytes that identify the content and length of each part."""
    digest = blake2b(digest_size=16)
    for part in parts:
        content = memoryview(np.ascontiguousarray(part)).cast("B") if isinstance(part, np.ndarray) else part
        digest.update(len(content).to_bytes(8, "little"))
        digest.update(content)
    return digest.digest()
