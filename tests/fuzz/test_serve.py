"""Whatever a program on this machine sends to the server: a picture, or one line."""

import pytest
from fuzzing import attempt, fuzzed
from hypothesis import given
from hypothesis import strategies as st
from mutations import altered, damaged, dumped
from serving import VIEW, scene

from rfpp.errors import SceneError
from rfpp.serve.image_window import Frame
from rfpp.serve.render_request import Asked
from rfpp.serve.sent_scenes import Received

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
