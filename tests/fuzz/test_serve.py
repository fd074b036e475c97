import socket
from collections.abc import Iterator
from contextlib import suppress

import pytest
from fuzzing import attempt, fuzzed
from hypothesis import given
from hypothesis import strategies as st
from mutations import altered, damaged, dumped
from serving import VIEW, scene, server

from rfpp.errors import SceneError
from rfpp.serve.image_window import ImageWindow
from rfpp.serve.render_request import RenderRequest
from rfpp.serve.scene_renderer import ReceivedScene
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
            request = RenderRequest.parse(content)
            window = ImageWindow.around(request.window, request.size, 8)
            request.camera(window.fov)
        except SceneError as error:
            require_one_line(error)
            return
        one.taken = True
        (height, width), (row, column), (rows, columns) = window.size, window.corner, window.image_size
        assert row >= 0 and row + height <= rows and column >= 0 and column + width <= columns


@pytest.fixture(scope="module")
def served() -> Iterator[Server]:
    with server(max_bytes=1 << 16) as started:
        yield started


def request(path: str, body: bytes) -> bytes:
    head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\nRfpp-Protocol: 1\r\nContent-Length: {len(body)}\r\n\r\n"
    return head.encode() + body


REQUESTS = [request("/pictures", dumped(DESCRIPTION)), request("/scenes", SCENE.glb())]


@fuzzed
@given(st.sampled_from(REQUESTS).flatmap(damaged) | st.binary(max_size=200))
def test_requests(served: Server, content: bytes) -> None:
    """Status 500 is a defect; a request that is not complete gets no response."""
    with attempt("requests to the server") as one, socket.create_connection(served.address, 0.2) as connection:
        answer = b""
        with suppress(ConnectionError, TimeoutError):  # the server may have refused already, or wait for more
            connection.sendall(content)
            answer = connection.recv(1 << 16)
        assert not answer.startswith(b"HTTP/1.1 500 ")
        one.taken = answer.startswith(b"HTTP/1.1 200 ")


@fuzzed
@given(damaged(SCENE.glb()) | altered(SCENE.document).map(rewritten))
def test_scenes(content: bytes) -> None:
    with attempt("scenes to the server") as one:
        try:
            ReceivedScene.read(content)
        except SceneError as error:
            require_one_line(error)
            return
        one.taken = True
