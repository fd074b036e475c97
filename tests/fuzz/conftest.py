"""What was tried is said at the end."""

import os
from pathlib import Path

from fuzzing import ATTEMPTS, write_table


def pytest_terminal_summary(terminalreporter):
    """What was tried; as a table, too, where FUZZ_TABLE names its file."""
    for kind in ATTEMPTS.values():
        told = f"{kind.taken} taken, slowest {kind.slowest:.1f} s, {kind.memory:.1f} GB"
        terminalreporter.write_line(f"fuzzed {kind.kind}: {kind.tried} tried, {told}")
    if table := os.environ.get("FUZZ_TABLE"):
        write_table(Path(table))
