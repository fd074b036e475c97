"""Whatever a program on this machine sends to the server: a picture, or one line."""

import socket
import sys
from collections.abc import Iterator
from contextlib import suppress

import pytest
from fuzzing import attempt, fuzzed
from hypothesis import given
from hypothesis import strategies as st
from mutations import altered, damaged, dumped
from serving import VIEW, scene, server

from rfpp.errors import SceneError
from rfpp.serve.image_window import Frame
from rfpp.serve.render_request import Asked
from rfpp.serve.sent_scenes import Received
from rfpp.serve.server import Server

pytestmark = pytest.mark.timeout(36_000)  # of thousands

SCENE, DESCRIPTION = scene(), VIEW | {"scene": "0" * 32}


def require_one_line(error: SceneError) -> None:
    assert str(error) and "\n" not in str(error)


@st.composite
def described(draw: st.DrawFn) -> bytes:
    """Pixels are square, whatever else."""
    left, bottom, pitch = draw(st.floats(-2, 2)), draw(st.floats(-2, 2)), draw(st.floats(1e-6, 0.1))
    height, width = draw(st.integers(1, 16384)), draw(st.integers(1, 16384))
    window = [left, left + pitch * width, bottom, bottom + pitch * height]
    return dumped(DESCRIPTION | {"window": window, "size": [height, width]})


def rewritten(document: dict) -> bytes:
    builder = scene()
    builder.document |= document
    return builder.glb()


@fuzzed
@given(described() | altered(DESCRIPTION).map(dumped) | damaged(dumped(DESCRIPTION)))
def test_descriptions(content: bytes) -> None:
    with attempt("descriptions to the server") as one:
        try:
            asked = Asked.of(content)
            frame = Frame.around(asked.window, asked.size, 8)
            asked.camera(frame.fov)
        except SceneError as error:
            require_one_line(error)
            return
        one.taken = True
        (height, width), (row, column), (rows, columns) = frame.window, frame.corner, frame.size
        assert row >= 0 and row + height <= rows and column >= 0 and column + width <= columns


@pytest.fixture(scope="module")
def served() -> Iterator[Server]:
    """What ends a request without an answer ends here: `defects`."""
    with server(max_bytes=1 << 16) as made:
        made.defects = []
        made.handle_error = lambda *_: made.defects.append(sys.exception())
        yield made


def request(path: str, body: bytes) -> bytes:
    head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\nRfpp-Protocol: 1\r\nContent-Length: {len(body)}\r\n\r\n"
    return head.encode() + body


REQUESTS = [request("/pictures", dumped(DESCRIPTION)), request("/scenes", SCENE.glb()[:200]), b"GET / HTTP/1.1\r\n\r\n"]


@fuzzed
@given(st.sampled_from(REQUESTS).flatmap(damaged) | st.binary(max_size=200))
def test_requests(served: Server, content: bytes) -> None:
    """An answer, or none to one who has left; status 500 is what becomes of a defect."""
    with attempt("requests to the server") as one, socket.create_connection(served.server_address[:2], 10) as sent:
        with suppress(ConnectionError):  # it may have refused already
            sent.sendall(content)
            sent.shutdown(socket.SHUT_WR)
        answer = b""
        with suppress(ConnectionError):
            while received := sent.recv(1 << 16):
                answer += received
        assert not [error for error in served.defects if not isinstance(error, OSError)]
        assert not answer.startswith(b"HTTP/1.0 500 ")
        one.taken = answer.startswith(b"HTTP/1.0 200 ")


@fuzzed
@given(damaged(SCENE.glb()) | altered(SCENE.document).map(rewritten))
def test_scenes(content: bytes) -> None:
    with attempt("scenes to the server") as one:
        try:
            Received.of(content)
        except SceneError as error:
            require_one_line(error)
            return
        one.taken = True
