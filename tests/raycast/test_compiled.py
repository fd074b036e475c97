"""Compiled loops are kept on disk until any of their sources changes, make no arrays and call no loops."""

import shutil
import subprocess
import sys

import numba
import numpy as np
import pytest
from numba.core.errors import NumbaError

from rfpp.raycast import compiled

CALLER = """
from loops.compiled import compiled
from loops.called import number

@compiled
def twice():
    return 2 * number()
"""
CALLED = """
from loops.compiled import compiled

@compiled
def number():
    return {}
"""


def test_a_change_in_what_a_loop_calls_is_noticed(tmp_path):
    loops = tmp_path / "loops"
    loops.mkdir()
    shutil.copy(compiled.__file__, loops / "compiled.py")
    (loops / "caller.py").write_text(CALLER)

    def run(number: int) -> list[int]:
        (loops / "called.py").write_text(CALLED.format(number))
        program = "from loops.caller import twice; print(twice(), sum(twice.stats.cache_hits.values()))"
        done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True)
        return [int(part) for part in done.stdout.split()]

    assert run(1) == [2, 0]
    assert run(1) == [2, 1]  # from disk
    assert run(7) == [14, 0]


@compiled.compiled
def makes_an_array() -> np.ndarray:
    return np.zeros(3)


def test_a_loop_that_makes_an_array_is_refused():
    """Then Numba would count references to all arrays that it is given, and threads would wait for each other."""
    with pytest.raises(NumbaError, match="NRT required|returning of array"):
        makes_an_array()


@compiled.compiled
def long_enough_to_be_called(values: np.ndarray, row: int) -> float:
    total = 0.0
    for k in range(row):
        total += (
            np.sin(values[k]) * np.cos(total) + np.exp(-values[k]) * np.sqrt(abs(total)) + np.arctan2(total, values[k])
        )
        while total > 2:
            total -= np.log(1 + total) * np.tanh(total)
    return total


@compiled.compiled
def makes_two_calls(values: np.ndarray, row: int) -> float:
    return long_enough_to_be_called(values, row) - long_enough_to_be_called(values[1:], row)


def test_what_a_loop_calls_is_part_of_it():
    makes_two_calls(np.ones(4), 3)
    [assembly] = makes_two_calls.inspect_asm().values()
    assert not [line for line in assembly.splitlines() if "long_enough" in line and "NumbaEnv" not in line]


def test_the_first_compilation_is_announced(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    said = []
    compiled.announce_compilation(said.append)
    (tmp_path / "loop.nbc").touch()
    compiled.announce_compilation(said.append)
    assert said == ["Compiling the ray loops, once per version: up to a minute …"]
