"""A cache with a limit in bytes that discards the least recently used values, and digests as its keys."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from hashlib import blake2b
from threading import Lock
from typing import Generic, TypeVar

import numpy as np

Value = TypeVar("Value")


class BoundedCache(Generic[Value]):
    """Thread-safe cache with a limit of all values together."""

    def __init__(self, max_bytes: int):
        self.max_bytes, self.bytes = max_bytes, 0
        self._entries: OrderedDict[Hashable, tuple[Value, int]] = OrderedDict()
        self._lock = Lock()
        self._computing: dict[Hashable, Lock] = {}

    def get(self, key: Hashable) -> Value | None:
        """Return a value, or None if it is not in the cache."""
        with self._lock:
            if key not in self._entries:
                return None
            self._entries.move_to_end(key)
            return self._entries[key][0]

    def put(self, key: Hashable, value: Value, size: int) -> None:
        """Store a value of `size` bytes, unless it exceeds the limit by itself."""
        with self._lock:
            self.bytes -= self._entries.pop(key, (None, 0))[1]
            if size > self.max_bytes:
                return
            self._entries[key] = value, size
            self.bytes += size
            while self.bytes > self.max_bytes:
                self.bytes -= self._entries.popitem(last=False)[1][1]

    def get_or_compute(self, key: Hashable, size: int, compute: Callable[[], Value]) -> Value:
        """Return a value; compute and store it first if it is missing.

        Threads that request the same value wait for one of them to compute it. `compute` may use other keys only.
        """
        with self._lock:
            computing = self._computing.setdefault(key, Lock())
        try:
            with computing:
                value = self.get(key)
                if value is None:
                    value = compute()
                    self.put(key, value, size)
                return value
        finally:
            with self._lock:
                self._computing.pop(key, None)


def digest_of(*parts: np.ndarray | bytes) -> bytes:
    """Return 16 bytes that identify the content and length of each part."""
    digest = blake2b(digest_size=16)
    for part in parts:
        content = memoryview(np.ascontiguousarray(part)).cast("B") if isinstance(part, np.ndarray) else part
        digest.update(len(content).to_bytes(8, "little"))
        digest.update(content)
    return digest.digest()
