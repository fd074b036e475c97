"""Summary of fuzzing at the end of the session."""

import os
from pathlib import Path

from fuzzing import ATTEMPTS, write_table


def pytest_terminal_summary(terminalreporter):
    """Print counts of inputs; also write them to the file named by FUZZ_TABLE."""
    for kind in ATTEMPTS.values():
        told = f"{kind.taken} taken, slowest {kind.slowest:.1f} s, {kind.memory:.1f} GB"
        terminalreporter.write_line(f"fuzzed {kind.kind}: {kind.tried} tried, {told}")
    if table := os.environ.get("FUZZ_TABLE"):
        write_table(Path(table))
