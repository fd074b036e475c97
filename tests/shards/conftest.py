"""Copies of the finished data set, for tests that damage it."""

import shutil

import pytest


@pytest.fixture
def copied(finished, tmp_path):
    """The folder of a copy."""
    return shutil.copytree(finished.root, tmp_path / "small")
