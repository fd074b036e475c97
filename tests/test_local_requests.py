"""Requests of this machine are accepted, those of foreign web pages refused."""

import socket

import pytest

from rfpp.local_requests import reason_to_refuse


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
def test_addresses_of_this_machine_are_accepted(host, origin):
    assert reason_to_refuse(host, origin) is None


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
def test_others_are_refused(host, origin):
    assert reason_to_refuse(host, origin) is not None
