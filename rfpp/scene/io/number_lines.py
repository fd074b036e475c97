"""Lines of numbers in a text, converted by the thousand: a scan has millions of them.

What is unusual in any way is left to a format's reader of single lines, which knows how to complain; of those a file
has only so many (`MAX_SINGLE_LINES`).
"""

from __future__ import annotations

import warnings

import numpy as np
from jaxtyping import Bool, Int, UInt8

from rfpp.errors import SceneError
from rfpp.scene.io.limits import MAX_LINE_BYTES

SPACE = np.isin(np.arange(256), list(b" \t\r\n\v\f"))
#: Lines at a time, which bounds the memory, and to how many of them a block is cut where not all are regular.
LINES, FEW_LINES = 1 << 16, 1 << 8
_NUMBER = np.isin(np.arange(256), list(b" \t\r\n0123456789+-.eE"))


def characters(content: bytes | bytearray) -> UInt8[np.ndarray, " n"]:
    """The bytes of a text as numbers, without a copy."""
    return np.frombuffer(content, np.uint8)


def line_bounds(text: UInt8[np.ndarray, " n"], start: int = 0) -> Int[np.ndarray, " bounds"]:
    """Where each line begins from a byte on, and the end. Raises SceneError for a line of absurd length."""
    ends = (np.flatnonzero(text[start:] == ord("\n")) + (start + 1)).astype(np.int32)
    bounds = np.append(np.int32(start), ends)
    if bounds[-1] < len(text):
        bounds = np.append(bounds, np.int32(len(text)))
    if (longest := int(np.diff(bounds).max(initial=0))) > MAX_LINE_BYTES:
        raise SceneError(f"a line has {longest:,} bytes: export it again")
    return bounds


def lines_where(
    text: UInt8[np.ndarray, " n"], bounds: Int[np.ndarray, " bounds"], chosen: Bool[np.ndarray, " lines"]
) -> tuple[UInt8[np.ndarray, " m"], Int[np.ndarray, " new_bounds"]]:
    """A copy of some lines of a text, and their bounds in it."""
    lengths = np.diff(bounds)
    picked = text[bounds[0] : bounds[-1]][np.repeat(chosen, lengths)]
    return picked, np.append(0, np.cumsum(lengths[chosen]))


def numbers(
    text: UInt8[np.ndarray, " n"], bounds: Int[np.ndarray, " bounds"], dtype: type = np.float64
) -> tuple[np.ndarray, Int[np.ndarray, " lines"]] | None:
    """All numbers of a text one after the other, and how many stand in each line; None: take the lines one by one."""
    if not _NUMBER[text].all():
        return None
    begins = token_starts(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of a rest that is no number, found by counting
        values = np.fromstring(text.tobytes(), dtype, sep=" ")
    return (values, np.diff(np.searchsorted(begins, bounds))) if len(values) == len(begins) else None


def token_starts(text: UInt8[np.ndarray, " n"]) -> Int[np.ndarray, " tokens"]:
    """Where what stands between spaces begins."""
    space = SPACE[text]
    return np.flatnonzero(~space & np.append(True, space[:-1]))
