"""What all fuzzed inputs share."""

import os
from pathlib import Path

import pytest
from fuzzing import ATTEMPTS, write_table
from small_data import make


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """The manifest of a complete small data set. Do not write into its folder."""
    return make(tmp_path_factory.mktemp("data") / "small")


def pytest_terminal_summary(terminalreporter):
    """What was tried; as a table, too, where FUZZ_TABLE names its file."""
    for kind in ATTEMPTS.values():
        told = f"{kind.taken} taken, slowest {kind.slowest:.1f} s, {kind.memory:.1f} GB"
        terminalreporter.write_line(f"fuzzed {kind.kind}: {kind.tried} tried, {told}")
    if table := os.environ.get("FUZZ_TABLE"):
        write_table(Path(table))
