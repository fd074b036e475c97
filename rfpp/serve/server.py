"""HTTP server for Blender's add-on.

| Request | Body | Response |
|---|---|---|
| POST /scenes | GLB file | JSON: `scene`, its name, and `notes`, the changes made to it |
| POST /pictures | JSON, see `RenderRequest` | float32 [height, width, 4], little-endian: radiance, alpha |

Errors are JSON with `error`, one line; status 404 means that the scene must be sent again. Every request needs the
header `Rfpp-Protocol`. Web pages cannot send it without a preflight request, which the server does not answer.
"""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Awaitable, Callable
from typing import TypeVar

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from rfpp.errors import UserError, one_line
from rfpp.inference.renderer import Renderer
from rfpp.local_requests import reason_to_refuse
from rfpp.serve.render_request import RenderRequest
from rfpp.serve.scene_renderer import SceneRenderer, UnknownSceneError

Result = TypeVar("Result")

#: Version of requests and responses.
PROTOCOL = 1
_HEADER = "Rfpp-Protocol"
#: Bytes of a picture's description, open connections, and seconds until the next bytes of a body arrive.
_MAX_DESCRIPTION, _MAX_CONNECTIONS, _PATIENCE = 1 << 16, 16, 30.0


class Server:
    """HTTP server in a thread of its own, with one renderer for one picture at a time; use as a context manager.

    It listens on `host` and `port` (0 chooses a free one), accepts scenes of up to `max_bytes`, and logs a line per
    picture. Raises UserError if the address is not one of this machine or is in use.
    """

    def __init__(
        self, renderer: Renderer, host: str, port: int, max_bytes: int, log: Callable[[str], None] = lambda line: None
    ) -> None:
        self.scenes, self._max_bytes, self._log = SceneRenderer(renderer), max_bytes, log
        self._receiving, self._rendering = asyncio.Lock(), asyncio.Lock()
        try:
            self._socket = socket.create_server((host, port), family=socket.getaddrinfo(host, port)[0][0])
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise UserError(f"host={host}: cannot listen at port {port} ({reason}): choose another") from None
        self.address: tuple[str, int] = self._socket.getsockname()[:2]
        endpoints = {"/scenes": self._receive, "/pictures": self._render}
        routes = [Route(path, _guarded(endpoint), methods=["POST"]) for path, endpoint in endpoints.items()]
        config = uvicorn.Config(
            Starlette(routes=routes, exception_handlers=_ERRORS), loop="asyncio", http="h11", ws="none", lifespan="off",
            log_config=None, access_log=False, limit_concurrency=_MAX_CONNECTIONS,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],), name="server", daemon=True)

    @property
    def url(self) -> str:
        """URL for the settings of the add-on."""
        host, port = self.address
        return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"

    def __enter__(self) -> Server:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join()

    async def _receive(self, request: Request) -> Response:
        async with self._receiving:  # one body in memory at a time
            content = await _body(request, self._max_bytes)
            received = await self._in_turn(request, lambda: self.scenes.receive(content))
        return JSONResponse({"scene": received.name, "notes": received.notes})

    async def _render(self, request: Request) -> Response:
        wanted = RenderRequest.parse(await _body(request, _MAX_DESCRIPTION))

        def render() -> bytes:
            begin = time.perf_counter()
            picture = self.scenes.render(wanted)
            self._log(f"{wanted.size[1]} x {wanted.size[0]} in {time.perf_counter() - begin:.2f} s")
            return picture.astype("<f4").tobytes()

        return Response(await self._in_turn(request, render), media_type="application/octet-stream")

    async def _in_turn(self, request: Request, work: Callable[[], Result]) -> Result:
        """Run `work` in a thread, one at a time, unless the client disconnects before its turn."""
        async with self._rendering:
            if await request.is_disconnected():
                raise ClientDisconnect
            return await run_in_threadpool(work)


def _guarded(endpoint: Callable[[Request], Awaitable[Response]]) -> Callable[[Request], Awaitable[Response]]:
    """Refuse web pages, other programs, and add-ons of another version."""

    async def respond(request: Request) -> Response:
        if reason := reason_to_refuse(request.headers.get("Host"), request.headers.get("Origin")):
            raise HTTPException(403, reason)
        if (version := request.headers.get(_HEADER)) != str(PROTOCOL):
            versions = f"the header {_HEADER} must be {PROTOCOL}, not {one_line(version or 'missing', 10)}"
            raise HTTPException(403, f"{versions}: install the add-on that `rfpp addon` writes")
        return await endpoint(request)

    return respond


async def _body(request: Request, limit: int) -> bytes:
    """Read a body. A larger one is discarded, so that a client that is still sending reads the response."""
    content, size, clock = bytearray(), 0, asyncio.get_running_loop().time
    async with asyncio.timeout(_PATIENCE) as patience:
        async for chunk in request.stream():
            patience.reschedule(clock() + _PATIENCE)
            size += len(chunk)
            content += chunk if size <= limit else b""
            if size > 4 * limit:
                break
    if size > limit:
        raise HTTPException(413, f"more than {limit:,} bytes: send less")
    return bytes(content)


def _error(status: int, message: str) -> Response:
    return JSONResponse({"error": message}, status)


_ERRORS = {
    ClientDisconnect: lambda _, error: _error(400, "disconnected"),
    TimeoutError: lambda _, error: _error(408, f"no bytes for {_PATIENCE:.0f} s: send the request again"),
    HTTPException: lambda _, error: _error(error.status_code, error.detail),
    UnknownSceneError: lambda _, error: _error(404, str(error)),
    UserError: lambda _, error: _error(422, str(error)),
    MemoryError: lambda _, error: _error(507, "not enough memory: reduce the resolution or the scene"),
    Exception: lambda _, error: _error(500, f"{type(error).__name__} in the server: report what it printed"),
}
