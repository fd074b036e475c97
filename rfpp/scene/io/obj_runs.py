"""Runs of like lines in an OBJ file, converted together: a scan has millions of them.

What is unusual in any way is left to the reader of single lines, which knows how to complain.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int, UInt8

from rfpp.errors import SceneError
from rfpp.scene.io.limits import MAX_LINE_BYTES

_KEYWORDS = (b"", b"v", b"vt", b"vn", b"f")
_SPACE, _NUMBER = (np.isin(np.arange(256), list(text)) for text in (b" \t\r\n\v\f", b" \t\r\n0123456789+-.eE/"))
#: Lines at a time, which bounds the memory.
_LINES = 1 << 16
#: Beyond this, numbers may be what NumPy made of a larger one.
_LARGEST = 1 << 40
#: Slashes in a corner of a face, and pairs of slashes → what its numbers are.
_CORNERS = {(0, 0): (0,), (1, 0): (0, 1), (2, 1): (0, 2), (2, 0): (0, 1, 2)}


@dataclass(frozen=True)
class Run:
    """Lines that follow each other: of vertices, normals and the like or of faces many, of all else one.

    Attributes:
        key: b"v", b"vt", b"vn" or b"f"; b"" for all else.
        first: number of the first line, from 1.
        text: of all of them.
        lines: how many.
    """

    key: bytes
    first: int
    text: bytes
    lines: int

    def vectors(self, width: int) -> Float[np.ndarray, "n width"] | None:
        """The first numbers of each line; None: take the lines one by one."""
        text = self._characters()
        if text is None:
            return None
        tokens = np.flatnonzero(_starts(text))
        numbers = _numbers(text, np.float64)
        if len(numbers) != len(tokens) or len(tokens) % self.lines or (text == ord("/")).any():
            return None
        table = numbers.reshape(self.lines, -1)
        return table[:, :width] if table.shape[1] >= width and self._regular(text, tokens) else None

    def polygons(self, counts: list[int]) -> Int[np.ndarray, "n corners 3"] | None:
        """Vertex, texture coordinate and normal at each corner of each face, -1 for none; None: as `vectors`.

        Args:
            counts: of vertices, texture coordinates and normals that stand before them.
        """
        text = self._characters()
        if text is None:
            return None
        tokens = np.flatnonzero(_starts(text))
        if not len(tokens) or len(tokens) % self.lines or not self._regular(text, tokens):
            return None
        slash = text == ord("/")
        pair = slash & np.append(slash[1:], False)
        of_corners = [np.add.reduceat(mask, tokens, dtype=np.int64) for mask in (slash, pair)]
        if any((number != number[0]).any() for number in of_corners):
            return None
        places = _CORNERS.get(tuple(int(number[0]) for number in of_corners))
        if places is None:
            return None
        numbers = _numbers(np.where(slash, np.uint8(ord(" ")), text), np.int64)
        if len(numbers) != len(tokens) * len(places):
            return None
        written = numbers.reshape(self.lines, -1, len(places))
        index = np.where(written > 0, written - 1, written + np.array(counts)[list(places)])
        if (written == 0).any() or (index < 0).any() or (index > _LARGEST).any():
            return None
        corners = np.full((*written.shape[:2], 3), -1)
        corners[:, :, places] = index
        return corners

    def _characters(self) -> UInt8[np.ndarray, " n"] | None:
        """The text without its keywords, if nothing but numbers and slashes are left."""
        if self.lines == 1:
            return None
        text = np.frombuffer(self.text, np.uint8).copy()
        starts = np.append(0, np.flatnonzero(text[:-1] == ord("\n")) + 1)
        for place in range(len(self.key)):
            text[starts + place] = ord(" ")
        return text if _NUMBER[text].all() else None

    def _regular(self, text: UInt8[np.ndarray, " n"], tokens: Int[np.ndarray, " t"]) -> bool:
        """Whether each line has as many tokens as the others."""
        ends = np.append(np.flatnonzero(text[:-1] == ord("\n")), len(text))
        return bool((np.searchsorted(tokens, ends) == np.arange(1, self.lines + 1) * (len(tokens) // self.lines)).all())


def runs(content: bytes) -> Iterator[Run]:
    """All lines of a text in order. Raises SceneError for one of absurd length."""
    text = np.frombuffer(content, np.uint8)
    ends = np.flatnonzero(text == ord("\n")) + 1
    if not len(ends) or ends[-1] < len(text):
        ends = np.append(ends, len(text))
    starts = np.append(0, ends[:-1])
    if (longest := int((ends - starts).max())) > MAX_LINE_BYTES:
        raise SceneError(f"a line has {longest:,} bytes: export it again")
    kinds = _kinds(text, starts)
    bounds = np.flatnonzero((np.diff(kinds) != 0) | (kinds[1:] == 0)) + 1
    for first, last in pairwise([0, *bounds.tolist(), len(kinds)]):
        for begin in range(first, last, _LINES):
            end = min(begin + _LINES, last)
            yield Run(_KEYWORDS[kinds[begin]], begin + 1, content[starts[begin] : ends[end - 1]], end - begin)


def _kinds(text: UInt8[np.ndarray, " n"], starts: Int[np.ndarray, " lines"]) -> Int[np.ndarray, " lines"]:
    """Which of `_KEYWORDS` each line begins with; 0 for none."""
    first, second, third = (text[np.minimum(starts + place, len(text) - 1)] for place in range(3))
    kinds = np.zeros(len(starts), np.int64)
    for number, key in enumerate(_KEYWORDS[1:], start=1):
        alike = (first == key[0]) & (_SPACE[second] if len(key) == 1 else (second == key[-1]) & _SPACE[third])
        kinds[alike] = number
    return kinds


def _starts(text: UInt8[np.ndarray, " n"]) -> np.ndarray:
    """Where tokens begin."""
    space = _SPACE[text]
    return ~space & np.append(True, space[:-1])


def _numbers(text: UInt8[np.ndarray, " n"], dtype: type) -> np.ndarray:
    """Those at the beginning of a text; what follows the first that is none is left out."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of such a rest, which callers find by counting
        return np.fromstring(text.tobytes(), dtype, sep=" ")
