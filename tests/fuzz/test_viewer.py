"""Values from a browser stay within what the page offers, and requests of foreign pages are refused."""

import math
from types import SimpleNamespace

import pytest
from fuzzing import attempt, fuzzed
from hypothesis import given
from hypothesis import strategies as st
from mutations import JSON_VALUES

from rfpp.serve.local_requests import reason_to_refuse
from rfpp.viewer.control_values import choice, colour, number, vector

pytestmark = pytest.mark.timeout(36_000)  # of thousands


@fuzzed
@given(JSON_VALUES | st.floats() | st.integers() | st.text() | st.binary())
def test_controls(value: object) -> None:
    with attempt("messages to the viewer") as one:
        one.taken = True
        assert 64 <= number(SimpleNamespace(value=value, min=64, max=512)) <= 512
        assert choice(SimpleNamespace(value=value, options=("a", "b"))) in ("a", "b")


@fuzzed
@given(JSON_VALUES | st.lists(JSON_VALUES | st.floats(), min_size=3, max_size=3))
def test_positions_and_colours(value: object) -> None:
    with attempt("messages to the viewer") as one:
        one.taken = True
        assert all(math.isfinite(x) for x in vector(SimpleNamespace(value=value)))
        assert all(0 <= x <= 255 and isinstance(x, int) for x in colour(SimpleNamespace(value=value)))


ADDRESSES = st.from_regex(r"[a-z0-9.\-\[\]:@/%]{0,30}", fullmatch=True) | st.text(max_size=30)


@fuzzed
@given(ADDRESSES, st.none() | ADDRESSES.map(lambda host: f"http://{host}"))
def test_requests(host: str, origin: str | None) -> None:
    with attempt("requests to the server") as one:
        why = reason_to_refuse(host, origin)
        one.taken = why is None
        assert why is not None or origin in (None, f"http://{host}")
