"""A cache bounded in bytes that forgets what was used longest ago."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Generic, TypeVar

Value = TypeVar("Value")


class BoundedCache(Generic[Value]):
    """Key → value, for any number of threads.

    Args:
        max_bytes: that the values may occupy together.
    """

    def __init__(self, max_bytes: int):
        self.max_bytes = max_bytes
        self.bytes = 0
        self._entries: OrderedDict[Hashable, tuple[Value, int]] = OrderedDict()
        self._lock = Lock()
        self._making: dict[Hashable, Lock] = {}

    def __len__(self) -> int:
        return len(self._entries)

    def get(self, key: Hashable) -> Value | None:
        """What was put under a key, if it is still there."""
        with self._lock:
            if key not in self._entries:
                return None
            self._entries.move_to_end(key)
            return self._entries[key][0]

    def put(self, key: Hashable, value: Value, size: int) -> None:
        """Keep a value of `size` bytes; one that would not fit even alone is not kept."""
        with self._lock:
            _, before = self._entries.pop(key, (None, 0))
            self.bytes -= before
            if size > self.max_bytes:
                return
            self._entries[key] = value, size
            self.bytes += size
            while self.bytes > self.max_bytes:
                _, (_, freed) = self._entries.popitem(last=False)
                self.bytes -= freed

    def recall(self, key: Hashable, size: int, make: Callable[[], Value]) -> Value:
        """What is under a key; where nothing is, what `make` makes, which is kept.

        Threads that want the same wait for the one that makes it. `make` may recall other keys, never its own.
        """
        with self._lock:
            making = self._making.setdefault(key, Lock())
        try:
            with making:
                value = self.get(key)
                if value is None:
                    value = make()
                    self.put(key, value, size)
                return value
        finally:
            with self._lock:
                self._making.pop(key, None)
