"""Threads of OpenMP and OpenBLAS hardly spin in a process that uses rfpp, unless its user has said how they wait."""

import os
import subprocess
import sys

import pytest

SPIN = ("GOMP_SPINCOUNT", "OPENBLAS_THREAD_TIMEOUT")
TELL = f"import rfpp, torch, os; print(*map(os.environ.get, {SPIN}))"


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, "3000 16"),
        ({"GOMP_SPINCOUNT": "17"}, "17 16"),
        ({"OMP_WAIT_POLICY": "active"}, "None 16"),
        ({"OPENBLAS_THREAD_TIMEOUT": "26"}, "3000 26"),
    ],
)
def test_threads_wait_as_the_user_says_and_briefly_otherwise(given, expected):
    plain = {name: value for name, value in os.environ.items() if name not in (*SPIN, "OMP_WAIT_POLICY")}
    told = subprocess.run([sys.executable, "-c", TELL], env=plain | given, capture_output=True, text=True, check=True)
    assert told.stdout.strip() == expected
