"""Who may use a server on this machine: programs and pages of this machine, by an address of its own.

Any web page can make its visitors' browsers send requests to 127.0.0.1. Such a request tells on itself: by an `Origin`
that is not ours or, where the page's own name was made to point here (DNS rebinding), by a `Host` that is that name.
"""

from __future__ import annotations

import ipaddress
import socket
from urllib.parse import urlsplit


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
        return f"This server is not known as '{host}': open it by this machine's name or address."
    if theirs != host:
        return f"A page of '{origin}' may not use this server."
    return None


def _is_ours(name: str) -> bool:
    """Whether a name is one that nobody else can make point here: an address, or this machine's own names."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name.lower() in {"localhost", socket.gethostname().lower(), socket.getfqdn().lower()}
    return True
