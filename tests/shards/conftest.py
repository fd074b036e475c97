"""One finished data set for all tests that only look at it, and copies for those that damage it."""

import shutil

import pytest
from small_data import make


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """The manifest of a complete small data set. Do not write into its folder."""
    return make(tmp_path_factory.mktemp("data") / "small")


@pytest.fixture
def copied(finished, tmp_path):
    """The folder of a copy."""
    return shutil.copytree(finished.root, tmp_path / "small")
