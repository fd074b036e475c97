"""Talking to `rfpp serve` on this machine."""

from __future__ import annotations

import contextlib
import http.client
import ipaddress
import json
import socket
import threading
from dataclasses import asdict, dataclass
from hashlib import blake2b
from urllib.parse import urlsplit

import numpy as np

#: What the server is asked for, see rfpp/serve/server.py.
PROTOCOL = "1"
#: Seconds to connect in.
_CONNECT = 3.0


class ServerError(Exception):
    """One line on why there is no picture."""


class Cancelled(Exception):  # noqa: N818
    """Nobody waits for the answer any longer."""


@dataclass(frozen=True)
class View:
    """What of a scene is to be seen, in Blender's coordinates.

    Attributes:
        camera_to_world: three rows of four.
        window: left, right, bottom and top of the picture in the plane at distance 1 before the camera.
        size: (height, width) in pixels.
        light_samples, supersampling: of the renderer.
        transparent: whether alpha is 0 where nothing is seen.
    """

    camera_to_world: tuple[tuple[float, ...], ...]
    window: tuple[float, float, float, float]
    size: tuple[int, int]
    light_samples: int
    supersampling: int
    transparent: bool = False


class Server:
    """One server.

    Attributes:
        notes: scene that was sent → what could not be taken as it is.

    Args:
        address: http://127.0.0.1:8700; of this machine alone.

    Raises:
        ServerError: another address.
    """

    def __init__(self, address: str) -> None:
        try:
            parts = urlsplit(address)
            host, port = parts.hostname or "", parts.port or 80
            local = host == "localhost" or ipaddress.ip_address(host).is_loopback
        except ValueError:
            local = False
        if not local or parts.scheme != "http":
            raise ServerError(f"'{address}' is no address on this machine: give one like http://127.0.0.1:8700")
        self.address, self._place = address, (host, port)
        self.notes: dict[str, list[str]] = {}

    def about(self) -> dict:
        """`network`: the name of what renders. Raises ServerError."""
        return json.loads(Request(self._place, "GET", "/").answer())

    def picture(self, scene: bytes, view: View, request: list[Request] | None = None) -> np.ndarray:
        """[h, w, 4] float32 radiance and alpha, row 0 at the top.

        Args:
            scene: a GLB file, sent if the server does not know it.
            request: is given what is under way, for another thread to cancel.

        Raises:
            ServerError, Cancelled.
        """
        name = blake2b(scene, digest_size=16).hexdigest()
        body = json.dumps({"scene": name, **asdict(view)}).encode()
        under_way = request if request is not None else []
        if name in self.notes:
            try:
                return self._pixels(body, view, under_way)
            except _UnknownSceneError:
                pass
        self.notes[name] = json.loads(self._post("/scenes", scene, under_way))["notes"]
        return self._pixels(body, view, under_way)

    def notes_of(self, scene: bytes) -> list[str]:
        """What could not be taken as it is of a scene that was sent."""
        return self.notes.get(blake2b(scene, digest_size=16).hexdigest(), [])

    def _pixels(self, body: bytes, view: View, under_way: list[Request]) -> np.ndarray:
        content = self._post("/pictures", body, under_way)
        if len(content) != 16 * view.size[0] * view.size[1]:
            raise ServerError(f"{self.address} answered with {len(content)} bytes: is it `rfpp serve`?")
        return np.frombuffer(content, "<f4").reshape(*view.size, 4)

    def _post(self, path: str, body: bytes, under_way: list[Request]) -> bytes:
        under_way[:] = [request := Request(self._place, "POST", path, body)]
        return request.answer()


class _UnknownSceneError(ServerError):
    """The scene must be sent."""


class Request:
    """One request; `cancel` may be called from another thread."""

    def __init__(self, place: tuple[str, int], method: str, path: str, body: bytes = b"") -> None:
        self._place, self._request = place, (method, path, body)
        self._connection = http.client.HTTPConnection(*place, timeout=_CONNECT)
        self._cancelled, self._lock = False, threading.Lock()

    def cancel(self) -> None:
        """The server passes over what nobody waits for."""
        with self._lock:
            self._cancelled = True
            if self._connection.sock is not None:
                with contextlib.suppress(OSError):  # closed already
                    self._connection.sock.shutdown(socket.SHUT_RDWR)

    def answer(self) -> bytes:
        """Raises ServerError, and Cancelled after `cancel`."""
        try:
            return self._answer()
        except (OSError, http.client.HTTPException) as error:
            if self._cancelled:
                raise Cancelled from None
            where = f"http://{self._place[0]}:{self._place[1]}"
            if isinstance(error, ConnectionRefusedError | TimeoutError | socket.gaierror):
                raise ServerError(f"No server at {where}: start one with `rfpp serve`") from None
            raise ServerError(f"{where} closed the connection ({error}): see what the server printed") from None
        finally:
            self._connection.close()

    def _answer(self) -> bytes:
        with self._lock:
            if self._cancelled:
                raise Cancelled
            self._connection.connect()
        self._connection.sock.settimeout(None)  # pictures take their time
        method, path, body = self._request
        headers = {"Rfpp-Protocol": PROTOCOL, "Content-Type": "application/octet-stream"}
        self._connection.request(method, path, body or None, headers)
        response = self._connection.getresponse()
        content = response.read()
        if response.status == http.client.OK:
            return content
        kind = _UnknownSceneError if response.status == http.client.NOT_FOUND else ServerError
        try:
            raise kind(str(json.loads(content)["error"]))
        except (ValueError, KeyError, TypeError):
            raise ServerError(f"the server answered {response.status}: is it `rfpp serve`?") from None
