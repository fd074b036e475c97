"""The names of the package itself."""

import re

import rfpp


def test_all_public_names_are_listed_and_exist():
    assert {"Renderer", "Scene", "load_scene", "__version__"} <= set(dir(rfpp))
    assert set(rfpp.__all__) <= set(dir(rfpp))
    assert all(getattr(rfpp, name).__doc__ for name in rfpp.__all__)
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*", rfpp.__version__)
