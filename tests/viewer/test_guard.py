"""Only pages that the viewer served itself may use it."""

import http.client
import socket

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from rfpp.viewer.guard import refusal


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("127.0.0.1:8080", None),
        ("localhost:8080", "http://localhost:8080"),
        ("[::1]:8080", "http://[::1]:8080"),
        ("192.0.2.7:8080", "http://192.0.2.7:8080"),
        (f"{socket.gethostname()}:8080", None),
    ],
)
def test_addresses_of_this_machine_are_answered(host, origin):
    assert refusal(host, origin) is None


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        (None, None),
        ("rebound.example:8080", None),
        ("rebound.example:8080", "http://rebound.example:8080"),
        ("127.0.0.1:8080", "http://page.example"),
        ("127.0.0.1:8080", "http://127.0.0.1:9999"),
        ("127.0.0.1:8080", "null"),
        ("127.0.0.1.page.example:8080", None),
    ],
)
def test_others_are_not(host, origin):
    assert refusal(host, origin) is not None


def get(viewer, **headers: str) -> int:
    connection = http.client.HTTPConnection(viewer.url.removeprefix("http://"), timeout=10)
    connection.request("GET", "/", headers=headers)
    status = connection.getresponse().status
    connection.close()
    return status


def test_the_server_serves_its_page_to_this_machine_alone(viewer):
    assert get(viewer) == 200
    assert get(viewer, Host="rebound.example") == 403


def test_a_page_from_elsewhere_cannot_connect(viewer):
    address, version = viewer.url.replace("http", "ws"), [f"viser-v{viser.__version__}"]
    with connect(address, origin=viewer.url, subprotocols=version) as own:
        assert own.recv(timeout=10)
    with (
        pytest.raises(InvalidStatus, match="403"),
        connect(address, origin="http://page.example", subprotocols=version),
    ):
        pass
