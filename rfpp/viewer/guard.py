"""Access control: only pages that the viewer served itself, opened by an address of this machine."""

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

from rfpp.own_machine import refusal


@contextmanager
def guarded() -> Iterator[None]:
    """viser's servers that are started within answer no request that is refused. viser has no such hook of its own."""
    serve = websockets.asyncio.server.serve

    def guarding(*args: Any, process_request: Any, **others: Any) -> Any:
        async def process(connection: ServerConnection, request: Request) -> Response | None:
            why = refusal(request.headers.get("Host"), request.headers.get("Origin"))
            if why is not None:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{why}\n")
            response = process_request(connection, request)
            return await response if inspect.isawaitable(response) else response

        return serve(*args, process_request=process, **others)

    with patch.object(websockets.asyncio.server, "serve", guarding):
        yield
