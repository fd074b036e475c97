"""Client of `rfpp serve` on this machine."""

from __future__ import annotations

import contextlib
import http.client
import ipaddress
import json
import socket
from dataclasses import asdict, dataclass
from hashlib import blake2b
from urllib.parse import urlsplit

import numpy as np

#: Version of requests and responses, see rfpp/serve/server.py.
PROTOCOL = "1"
#: Seconds to wait for a connection.
_CONNECT = 3.0


class ServerError(Exception):
    """Reason for a missing picture, one line."""


class UnknownSceneError(ServerError):
    """The scene must be sent again."""


class Cancelled(Exception):  # noqa: N818
    """The request was cancelled."""


@dataclass(frozen=True)
class View:
    """View of a scene in Blender's coordinates; the fields of rfpp/serve/render_request.py."""

    camera_to_world: tuple[tuple[float, ...], ...]
    window: tuple[float, float, float, float]
    size: tuple[int, int]
    light_samples: int
    supersampling: int
    transparent: bool = False


class Connection:
    """Requests in order; `cancel` may be called from another thread."""

    def __init__(self, host: str, port: int) -> None:
        self._url, self.http = f"http://{host}:{port}", http.client.HTTPConnection(host, port, timeout=_CONNECT)
        self._cancelled = False

    def cancel(self) -> None:
        """Make the current request and all later ones raise Cancelled."""
        self._cancelled = True
        if (sock := self.http.sock) is not None:
            with contextlib.suppress(OSError):  # closed already
                sock.shutdown(socket.SHUT_RDWR)

    def post(self, path: str, body: bytes) -> bytes:
        """Return the response. Raises ServerError if it is an error or there is no server, Cancelled after `cancel`."""
        try:
            if self.http.sock is None:
                self.http.connect()
            self.http.sock.settimeout(None)  # pictures take a while
            if self._cancelled:
                raise Cancelled
            headers = {"Rfpp-Protocol": PROTOCOL, "Content-Type": "application/octet-stream"}
            self.http.request("POST", path, body, headers)
            response = self.http.getresponse()
            content = response.read()
        except (OSError, http.client.HTTPException) as error:
            if self._cancelled:
                raise Cancelled from None
            if isinstance(error, ConnectionRefusedError | TimeoutError | socket.gaierror):
                raise ServerError(f"No server at {self._url}: start one with `rfpp serve`") from None
            raise ServerError(f"{self._url} closed the connection ({error}): see the server's output") from None
        if response.status == http.client.OK:
            return content
        kind = UnknownSceneError if response.status == http.client.NOT_FOUND else ServerError
        try:
            raise kind(str(json.loads(content)["error"]))
        except (ValueError, KeyError, TypeError):
            raise ServerError(f"{self._url} answered {response.status}: is it `rfpp serve`?") from None


class Server:
    """A server at an address such as http://127.0.0.1:8700. Raises ServerError if it is not on this machine."""

    def __init__(self, address: str) -> None:
        try:
            parts = urlsplit(address)
            self._host, self._port = parts.hostname or "", parts.port or 80
            is_local = self._host == "localhost" or ipaddress.ip_address(self._host).is_loopback
        except ValueError:
            is_local = False
        if not is_local or parts.scheme != "http":
            raise ServerError(f"'{address}' is not an address of this machine: give one like http://127.0.0.1:8700")
        self.address = address
        self._notes: dict[str, list[str]] = {}

    def connect(self) -> Connection:
        """Return a new connection, opened by its first request."""
        return Connection(self._host, self._port)

    def picture(self, scene: bytes, view: View, connection: Connection | None = None) -> np.ndarray:
        """Return float32 radiance and alpha [h, w, 4] of a GLB file, row 0 at the top; raises as `Connection.post`.

        The file is sent if the server does not have it. Another thread may cancel the connection, which is closed.
        """
        name = _name(scene)
        request = json.dumps({"scene": name, **asdict(view)}).encode()
        connection = connection or self.connect()
        with contextlib.closing(connection.http):
            content = None
            if name in self._notes:
                with contextlib.suppress(UnknownSceneError):
                    content = connection.post("/pictures", request)
            if content is None:
                self._notes[name] = json.loads(connection.post("/scenes", scene))["notes"]
                content = connection.post("/pictures", request)
        if len(content) != 16 * view.size[0] * view.size[1]:
            raise ServerError(f"{self.address} answered with {len(content)} bytes: is it `rfpp serve`?")
        return np.frombuffer(content, "<f4").reshape(*view.size, 4)

    def notes(self, scene: bytes) -> list[str]:
        """Return the changes that the server made to a scene."""
        return self._notes.get(_name(scene), [])


def _name(scene: bytes) -> str:
    return blake2b(scene, digest_size=16).hexdigest()
