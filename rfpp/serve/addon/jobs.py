"""Pictures that are made while Blender goes on."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np

from .client import Cancelled, Request, Server, ServerError, View
from .viewport import shrunk, square_pixels

#: Pixels along the longer side of the smallest picture, and seconds that one may take while the view changes.
_SMALLEST, _SECONDS = 64, 0.25


class Job:
    """One picture, begun at once in a thread of its own.

    Attributes:
        picture: [h, w, 4], once there is one.
        error: one line, if there was an error.
    """

    def __init__(self, server: Server, scene: bytes, view: View) -> None:
        self.picture: np.ndarray | None = None
        self.error = ""
        self._server, self._scene, self._view = server, scene, view
        self._request: list[Request] = []
        self._cancelled = False
        self._thread = threading.Thread(target=self._run, name="rfpp picture", daemon=True)
        self._thread.start()

    def wait(self, seconds: float) -> bool:
        """Whether it has ended within these seconds."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def cancel(self) -> None:
        """Returns once the thread has ended."""
        self._cancelled = True
        while self._thread.is_alive():
            for request in self._request:
                request.cancel()
            self._thread.join(0.05)

    def _run(self) -> None:
        try:
            picture = self._server.picture(self._scene, self._view, self._request)
            self.picture = None if self._cancelled else picture
        except Cancelled:
            pass
        except ServerError as error:
            self.error = "" if self._cancelled else str(error)


class Newest:
    """Pictures of a view that keeps changing: small while it does, whole once it rests.

    What is outdated is never asked for. A thread lives while there is something to do.

    Attributes:
        picture: the newest there is, [h, w, 4].
        error: one line, where the newest could not be had.

    Args:
        server: where they are made.
    """

    def __init__(self, server: Server) -> None:
        self.server = server
        self.picture: np.ndarray | None = None
        self.error = ""
        self._wanted: tuple[bytes, View] | None = None
        self._lock, self._thread = threading.Lock(), None
        self._per_pixel: float | None = None

    @property
    def is_busy(self) -> bool:
        """Whether another picture will come."""
        with self._lock:
            return self._thread is not None

    def want(self, scene: bytes, view: View) -> None:
        """Another view, or the same one."""
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
            size = self._soon(view.size)  # of whole pixels, so hardly ever of the same shape
            small = view if size == view.size else replace(view, size=size, window=square_pixels(view.window, size))
            if self._draw(scene, small) and small.size != view.size and self._wanted is wanted:
                self._draw(scene, view)
            done = wanted

    def _draw(self, scene: bytes, view: View) -> bool:
        begin = time.perf_counter()
        try:
            picture = self.server.picture(scene, view)
        except (ServerError, Cancelled) as error:
            self.error = str(error)
            return False
        self.picture, self.error = picture, ""
        per_pixel = (time.perf_counter() - begin) / (view.size[0] * view.size[1])
        self._per_pixel = per_pixel if self._per_pixel is None else (self._per_pixel + per_pixel) / 2
        return True

    def _soon(self, size: tuple[int, int]) -> tuple[int, int]:
        """(height, width) of a picture that does not take long."""
        longer = max(size)
        if self._per_pixel is None:
            return shrunk(size, _SMALLEST)
        share = (_SECONDS / (self._per_pixel * size[0] * size[1])) ** 0.5
        return shrunk(size, max(_SMALLEST, int(longer * min(share, 1.0))))
