"""Only pages that the viewer served itself may use it."""

import http.client

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect


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
