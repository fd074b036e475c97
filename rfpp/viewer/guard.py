"""Access control of the viewer: only pages that it served itself, opened by an address of this machine."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from unittest.mock import patch

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from rfpp.local_requests import reason_to_refuse


@contextmanager
def guarded() -> Iterator[None]:
    """Make viser servers that start in this block refuse requests of foreign web pages.

    viser passes no hook to the websockets server that it starts. Without this patch, any web page that is open on the
    machine could connect to the viewer, read scenes and send edits.
    """
    serve = websockets.asyncio.server.serve

    def guarding(*args: Any, process_request: Any, **others: Any) -> Any:
        async def process(connection: ServerConnection, request: Request) -> Response | None:
            reason = reason_to_refuse(request.headers.get("Host"), request.headers.get("Origin"))
            if reason is not None:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n")
            response = process_request(connection, request)
            return await response if inspect.isawaitable(response) else response

        return serve(*args, process_request=process, **others)

    with patch.object(websockets.asyncio.server, "serve", guarding):
        yield
