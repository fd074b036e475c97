"""Tell requests of this machine's programs from those of foreign web pages.

Any web page can make a visitor's browser send requests to 127.0.0.1. Their headers reveal it: a foreign `Origin` or, if
the page's own name was made to point here (DNS rebinding), a `Host` with that name.
"""

from __future__ import annotations

import ipaddress
import socket
from urllib.parse import urlsplit


def reason_to_refuse(host: str | None, origin: str | None) -> str | None:
    """Return the reason to refuse a request; None accepts it.

    Args:
        origin: `Origin` header, which only browsers send.
    """
    try:
        name = urlsplit(f"//{host}").hostname if host else None
        origin_host = urlsplit(origin).netloc if origin is not None else host
    except ValueError:  # not an address
        name = origin_host = None
    if name is None or not _is_local(name):
        return f"This server is not known as '{host}': open it by this machine's name or address."
    if origin_host != host:
        return f"A page of '{origin}' may not use this server."
    return None


def _is_local(name: str) -> bool:
    """Return True for an IP address or a name of this machine: nobody else can make these point here."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name.lower() in {"localhost", socket.gethostname().lower(), socket.getfqdn().lower()}
    return True
