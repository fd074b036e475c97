"""Threads of OpenMP hardly spin in a process that uses rfpp, unless its user has said how they are to wait."""

import os
import subprocess
import sys

import pytest

TELL = "import rfpp, torch, os; print(os.environ.get('GOMP_SPINCOUNT'))"


@pytest.mark.parametrize(
    ("given", "expected"),
    [({}, "3000"), ({"GOMP_SPINCOUNT": "17"}, "17"), ({"OMP_WAIT_POLICY": "active"}, "None")],
)
def test_threads_wait_as_the_user_says_and_briefly_otherwise(given, expected):
    plain = {name: value for name, value in os.environ.items() if name not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")}
    told = subprocess.run([sys.executable, "-c", TELL], env=plain | given, capture_output=True, text=True, check=True)
    assert told.stdout.strip() == expected
