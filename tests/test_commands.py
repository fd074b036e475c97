"""What all commands share."""

import subprocess
import sys
from pathlib import Path

from rfpp.commands import with_groups

ROOT = Path(__file__).parents[1]


def test_experiments_are_named_with_or_without_a_plus():
    given = ["-m", "experiment=[ablation,linear_light]", "+experiment=quickstart", "debug=one_batch", "data.name=a=b"]
    assert with_groups(given) == [
        "-m", "+experiment=[ablation,linear_light]", "+experiment=quickstart", "+debug=one_batch", "data.name=a=b"
    ]  # fmt: skip


def test_the_command_line_takes_either():
    composed = [
        subprocess.run(
            [sys.executable, "launch/train.py", f"{plus}experiment=quickstart", "run_dir=unused", "--cfg", "job"],
            cwd=ROOT, capture_output=True, text=True, check=True,
        ).stdout
        for plus in ("", "+")
    ]  # fmt: skip
    assert composed[0] == composed[1] and "name: quickstart" in composed[0]
