"""Pictures of a changing view, requested in a thread."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np

from .client import Server, ServerError, View
from .windows import shrunk, square_pixels

#: Pixels along the longer side of the smallest picture, and seconds per picture while the view changes.
_SMALLEST, _SECONDS = 64, 0.25


class Newest:
    """Pictures of a changing view: small while it changes, in full once it rests. Outdated views are skipped."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self.picture: np.ndarray | None = None  # the newest
        self.error = ""  # reason for a missing newer picture
        self._wanted: tuple[bytes, View] | None = None
        self._lock, self._thread = threading.Lock(), None
        self._seconds_per_pixel: float | None = None

    @property
    def is_busy(self) -> bool:
        """True if another picture will follow."""
        with self._lock:
            return self._thread is not None

    def want(self, scene: bytes, view: View) -> None:
        """Request a picture, unless it is the one requested last."""
        with self._lock:
            if self._wanted is not None and self._wanted[0] is scene and self._wanted[1] == view:
                return
            self._wanted = scene, view
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="rfpp viewport", daemon=True)
                self._thread.start()

    def _run(self) -> None:
        done: tuple[bytes, View] | None = None
        while True:
            with self._lock:
                wanted = self._wanted
                if wanted is done:
                    self._thread = None
                    return
            scene, view = wanted
            size = self._fast_size(view.size)  # rounded, so its pixels have to be made square again
            draft = view if size == view.size else replace(view, size=size, window=square_pixels(view.window, size))
            if self._draw(scene, draft) and size != view.size and self._wanted is wanted:
                self._draw(scene, view)
            done = wanted

    def _draw(self, scene: bytes, view: View) -> bool:
        begin = time.perf_counter()
        try:
            self.picture, self.error = self.server.picture(scene, view), ""
        except ServerError as error:
            self.error = str(error)
            return False
        newest = (time.perf_counter() - begin) / (view.size[0] * view.size[1])
        self._seconds_per_pixel = (newest + (self._seconds_per_pixel or newest)) / 2
        return True

    def _fast_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return (height, width) of a picture that takes about `_SECONDS`."""
        if self._seconds_per_pixel is None:
            return shrunk(size, _SMALLEST)
        share = (_SECONDS / (self._seconds_per_pixel * size[0] * size[1])) ** 0.5
        return shrunk(size, max(_SMALLEST, int(max(size) * min(share, 1.0))))
