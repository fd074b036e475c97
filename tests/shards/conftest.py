"""A copy of the finished data set, for tests that damage it."""

import shutil

import pytest


@pytest.fixture
def copied(finished, tmp_path):
    """Folder of the copy."""
    return shutil.copytree(finished.root, tmp_path / "small")
