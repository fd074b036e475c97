"""Access control: only pages that the viewer served itself, opened by an address of this machine.

Any web page can make its visitors' browsers send requests to 127.0.0.1. Such a request tells on itself: by an `Origin`
that is not ours or, where the page's own name was made to point here (DNS rebinding), by a `Host` that is that name.
"""

from __future__ import annotations

import inspect
import ipaddress
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from unittest.mock import patch
from urllib.parse import urlsplit

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response


def refusal(host: str | None, origin: str | None) -> str | None:
    """Why a request is not answered; None if it is.

    Args:
        host, origin: its headers of these names. Only browsers send the second, and all do where it matters.
    """
    try:
        name = urlsplit(f"//{host}").hostname if host else None
        theirs = urlsplit(origin).netloc if origin is not None else host
    except ValueError:  # no address at all
        name = theirs = None
    if name is None or not _is_ours(name):
        return f"This viewer is not known as '{host}': open it by this machine's name or address."
    if theirs != host:
        return f"A page of '{origin}' may not use this viewer."
    return None


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


def _is_ours(name: str) -> bool:
    """Whether a name is one that nobody else can make point here: an address, or this machine's own names."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name.lower() in {"localhost", socket.gethostname().lower(), socket.getfqdn().lower()}
    return True
