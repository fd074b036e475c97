"""The HTTP side: who is answered, how much is read, and one line of JSON for whatever is wrong.

| Request | Body | Answer |
|---|---|---|
| GET / | | JSON: `protocol`, `network` |
| POST /scenes | a GLB file | JSON: `scene`, a name for it, and `notes` on what could not be taken as it is |
| POST /pictures | JSON, see `render_request` | float32 [height, width, 4], little-endian: radiance and alpha |

Errors are JSON: `error`, one line. 404 is a scene that is not known any longer. Row 0 of a picture is on top. Every
request has the header `Rfpp-Protocol`; a web page cannot send it without asking first, and is not answered.
"""

from __future__ import annotations

import json
import select
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from rfpp.errors import UserError, one_line
from rfpp.serve.local_requests import reason_to_refuse
from rfpp.serve.render_request import Asked
from rfpp.serve.studio import Left, Studio, UnknownScene

#: Raised when requests or answers change.
PROTOCOL = 1
_HEADER = "Rfpp-Protocol"
#: Bytes of a description of a picture, requests at a time, seconds in which bytes that were announced come.
_MAX_DESCRIPTION, _MAX_REQUESTS, _PATIENCE = 1 << 16, 16, 30.0


class Refused(Exception):  # noqa: N818
    """A request that is answered with this status and line."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status = status


class Server(ThreadingHTTPServer):
    """Answers from other threads while the context lasts.

    Args:
        studio: where pictures are made.
        host, port: where to listen; 0 takes a free port.
        max_bytes: of the scenes that are being read at one time.
        say: is given a line about each picture.

    Raises:
        UserError: host or port is none of this machine's, or the port is taken.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(
        self, studio: Studio, host: str, port: int, max_bytes: int, say: Callable[[str], None] = lambda line: None
    ) -> None:
        self.studio, self.say, self._free_bytes, self.max_bytes = studio, say, max_bytes, max_bytes
        self._requests, self._bytes = threading.BoundedSemaphore(_MAX_REQUESTS), threading.Lock()
        try:
            self.address_family = socket.getaddrinfo(host, port)[0][0]
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise UserError(f"{host}:{port}: cannot be listened at ({reason}): choose another host or port") from None
        self._thread = threading.Thread(target=self.serve_forever, args=(0.1,), name="server", daemon=True)

    @property
    def url(self) -> str:
        """For the settings of the add-on."""
        host, port = self.server_address[:2]
        return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"

    def __enter__(self) -> Server:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()
        self._thread.join()
        self.server_close()

    def process_request(self, request: socket.socket, client_address: Any) -> None:
        """In a thread, while there are not too many."""
        if self._requests.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: socket.socket, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._requests.release()

    def handle_error(self, request: socket.socket, client_address: Any) -> None:
        """A connection that breaks is no error."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)

    def reserve(self, count: int) -> bool:
        """Bytes that are going to be read; given back by a negative count. False where there are too many."""
        with self._bytes:
            if count > self._free_bytes:
                return False
            self._free_bytes -= count
            return True


class _Handler(BaseHTTPRequestHandler):
    server: Server
    timeout = _PATIENCE
    server_version, sys_version = "rfpp", ""

    def do_GET(self) -> None:
        self._answer(self._about)

    def do_POST(self) -> None:
        self._answer({"/scenes": self._scene, "/pictures": self._picture}.get(self.path, self._nothing))

    def _about(self) -> bytes:
        if self.path != "/":
            return self._nothing()
        return _json(protocol=PROTOCOL, network=self.server.studio.renderer.info.method)

    def _nothing(self) -> bytes:
        raise Refused(HTTPStatus.NOT_FOUND, f"{one_line(self.path, 60)}: there is nothing here")

    def _scene(self) -> bytes:
        length = self._length(self.server.max_bytes)
        if not self.server.reserve(length):
            raise Refused(HTTPStatus.SERVICE_UNAVAILABLE, "other scenes are being received: try again")
        try:
            received = self.server.studio.receive(self._body(length), self._has_left)
        finally:
            self.server.reserve(-length)
        return _json(scene=received.name, notes=received.notes)

    def _picture(self) -> bytes:
        asked, begin = Asked.of(self._body(self._length(_MAX_DESCRIPTION))), time.perf_counter()
        picture = self.server.studio.picture(asked, self._has_left)
        height, width = asked.size
        self.server.say(f"{width} x {height} in {time.perf_counter() - begin:.2f} s")
        return picture.astype("<f4").tobytes()

    def _answer(self, make: Callable[[], bytes]) -> None:
        status = HTTPStatus.OK
        try:
            self._require_known()
            content = make()
        except (Left, TimeoutError, ConnectionError):
            self.close_connection = True
            return
        except Refused as refused:
            status, content = refused.status, _json(error=str(refused))
        except UnknownScene:
            status, content = HTTPStatus.NOT_FOUND, _json(error="this scene is not known here: send it first")
        except UserError as error:
            status, content = HTTPStatus.UNPROCESSABLE_ENTITY, _json(error=str(error))
        except MemoryError:
            status, content = HTTPStatus.INSUFFICIENT_STORAGE, _json(error="there is not enough memory: ask for less")
        except Exception as error:  # a defect; the server goes on
            traceback.print_exc()
            content = _json(error=f"{type(error).__name__} in the server, which has printed more: report it")
            status = HTTPStatus.INTERNAL_SERVER_ERROR
        self.send_response(status)
        is_picture = status is HTTPStatus.OK and make == self._picture
        self.send_header("Content-Type", "application/octet-stream" if is_picture else "application/json")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def _require_known(self) -> None:
        """Raises Refused for strangers, and for an add-on of another version."""
        if why := reason_to_refuse(self.headers.get("Host"), self.headers.get("Origin")):
            raise Refused(HTTPStatus.FORBIDDEN, why)
        given = self.headers.get(_HEADER)
        if given is None:
            raise Refused(
                HTTPStatus.FORBIDDEN, f"requests without the header {_HEADER} are not answered: use the add-on"
            )
        if given != str(PROTOCOL):
            raise Refused(HTTPStatus.UPGRADE_REQUIRED, f"this server speaks version {PROTOCOL}, the add-on "
                          f"{one_line(given, 10)}: install the add-on that `rfpp addon` writes")  # fmt: skip

    def _length(self, most: int) -> int:
        """Of the body. Raises Refused: not given, or too large."""
        given = self.headers.get("Content-Length", "")
        if not (given.isascii() and given.isdigit() and len(given) < 19) or "Transfer-Encoding" in self.headers:
            raise Refused(HTTPStatus.LENGTH_REQUIRED, "the length of the request is not given")
        if int(given) > most:
            self._discard(min(int(given), 4 * most))
            raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                          f"{int(given):,} bytes are more than the {most:,} that are read: send less")  # fmt: skip
        return int(given)

    def _body(self, length: int) -> bytes:
        content = self.rfile.read(length)
        if len(content) < length:
            raise ConnectionError
        return content

    def _discard(self, length: int) -> None:
        """So that the other side, which is still sending, reads the answer and not that the connection broke."""
        while length > 0 and (read := len(self.rfile.read(min(length, 1 << 20)))):
            length -= read

    def _has_left(self) -> bool:
        """Whether the other side has closed the connection."""
        try:
            readable, _, _ = select.select([self.connection], [], [], 0)
            return bool(readable) and not self.connection.recv(1, socket.MSG_PEEK)
        except (OSError, ValueError):
            return True

    def log_message(self, format: str, *args: Any) -> None:
        """Silent: what goes wrong is said to whoever asked."""


def _json(**values: object) -> bytes:
    return json.dumps(values).encode()
