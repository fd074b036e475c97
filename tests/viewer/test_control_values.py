"""What a browser may send, and what is made of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from rfpp.viewer.control_values import choice, colour, number, vector

SLIDER = {"min": 64, "max": 512}


@pytest.mark.parametrize(
    ("sent", "taken"), [(100, 100), (4096, 512), (-1, 64), (float("nan"), 64), (float("inf"), 512), (10**30, 512)]
)
def test_numbers_stay_on_their_slider(sent, taken):
    assert number(SimpleNamespace(value=sent, **SLIDER)) == taken


def test_choices_are_among_the_options():
    assert choice(SimpleNamespace(value="b", options=("a", "b"))) == "b"
    assert choice(SimpleNamespace(value="../etc", options=("a", "b"))) == "a"


def test_vectors_are_finite_and_colours_eight_bits():
    assert np.isfinite(vector(SimpleNamespace(value=(1e308, float("nan"), -float("inf"))))).all()
    assert vector(SimpleNamespace(value=(0.5, -2.0, 3.0))) == (0.5, -2.0, 3.0)
    assert colour(SimpleNamespace(value=(300, -4, 17))) == (255, 0, 17)
