"""Blocks of lines in an OBJ file: which keyword each begins with, and those of one keyword converted together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from rfpp.errors import SceneError
from rfpp.scene.io.limits import MAX_SINGLE_LINES, MAX_TRIANGLES
from rfpp.scene.io.number_lines import LINES, SPACE, characters, line_bounds, lines_where, numbers, token_starts

#: Vectors and the numbers that are read of each.
WIDTHS = {b"v": 3, b"vt": 2, b"vn": 3}
#: Empty lines and comments, all else that is not a vector, vectors, faces.
_NOTHING, _OTHER, *_VECTORS, _FACE = range(6)
#: Beyond this, indices may be what NumPy made of a larger number.
_LARGEST = 2**31 - 1
#: Slashes in a corner of a face, and pairs of slashes → what its numbers are.
_CORNERS = {(0, 0): (0,), (1, 0): (0, 1), (2, 1): (0, 2), (2, 0): (0, 1, 2)}


@dataclass(frozen=True, eq=False)
class Block:
    """Lines that follow each other.

    Attributes:
        first: number of the first, from 1.
        text: of the whole file.
        bounds: where each line begins in it, and the end of the last.
        kinds: what each line is.
    """

    first: int
    text: UInt8[np.ndarray, " n"]
    bounds: Int[np.ndarray, " bounds"]
    kinds: Int[np.ndarray, " lines"]

    def __len__(self) -> int:
        return len(self.kinds)

    @property
    def faces_before(self) -> Int[np.ndarray, " lines"]:
        """Faces of this block up to each line."""
        return np.cumsum(self.kinds == _FACE)

    @property
    def faces(self) -> Int[np.ndarray, " faces"]:
        """The lines that are faces, counted from 0."""
        return np.flatnonzero(self.kinds == _FACE)

    @property
    def others(self) -> Int[np.ndarray, " others"]:
        """The lines that are neither empty nor vectors nor faces, counted from 0."""
        return np.flatnonzero(self.kinds == _OTHER)

    @property
    def has_indented_lines(self) -> bool:
        """Whether any other line begins with a space, behind which any keyword may stand."""
        return bool(SPACE[self.text[self.bounds[self.others]]].any())

    def line(self, number: int) -> bytes:
        return self.text[self.bounds[number] : self.bounds[number + 1]].tobytes()

    def pieces(self, size: int) -> Iterator[Block]:
        """The same lines, so many at a time."""
        for i in range(0, len(self), size):
            yield Block(self.first + i, self.text, self.bounds[i : i + size + 1], self.kinds[i : i + size])

    def vectors(self, key: bytes) -> Float[np.ndarray, "n width"] | None:
        """All of one keyword, each with its first numbers; None: take the lines one by one."""
        kind, width = _VECTORS[list(WIDTHS).index(key)], WIDTHS[key]
        text, bounds = lines_where(self.text, self.bounds, self.kinds == kind)
        for place in range(len(key)):
            text[bounds[:-1] + place] = ord(" ")
        if (found := numbers(text, bounds)) is None:
            return None
        values, counts = found
        if not len(counts):
            return np.empty((0, width))
        if counts.min() < width:
            return None
        return values[(np.cumsum(counts) - counts)[:, None] + np.arange(width)]

    def polygons(self, counts: list[int]) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, "corners 3"]] | None:
        """How many corners each face has, and vertex, texture coordinate and normal at each, -1 for none.

        None: take the lines one by one.

        Args:
            counts: of vertices, texture coordinates and normals that stand before the block.
        """
        text, bounds = lines_where(self.text, self.bounds, self.kinds == _FACE)
        if not len(text):
            return np.empty(0, np.int64), np.empty((0, 3), np.int64)
        text[bounds[:-1]] = ord(" ")
        begins = token_starts(text)
        if not len(begins):
            return None
        slash = text == ord("/")
        pair = slash & np.append(slash[1:], False)
        of_corners = [np.add.reduceat(mask, begins, dtype=np.int64) for mask in (slash, pair)]
        places = _CORNERS.get(tuple(int(number[0]) for number in of_corners))
        if places is None or any((number != number[0]).any() for number in of_corners):
            return None
        sizes = np.diff(np.searchsorted(begins, bounds))
        found = numbers(np.where(slash, np.uint8(ord(" ")), text), bounds, np.int64)
        if found is None or len(found[0]) != len(begins) * len(places):
            return None
        written = found[0].reshape(-1, len(places))
        if written.min() < 0:  # counted back from the face
            there = np.stack([counts[p] + np.cumsum(self.kinds == _VECTORS[p])[self.kinds == _FACE] for p in places], 1)
            written = np.where(written < 0, written + 1 + np.repeat(there, sizes, axis=0), written)
        if written.min() < 1 or written.max() > _LARGEST:
            return None
        corners = np.full((len(written), 3), -1)
        corners[:, places] = written - 1
        return sizes, corners


def blocks(content: bytes) -> Iterator[Block]:
    """All lines of a text in order.

    Raises:
        SceneError: a line of absurd length; more faces, vectors or lines of other kinds than are ever read.
    """
    text = characters(content)
    bounds = line_bounds(text)
    kinds = _kinds(text, bounds[:-1])
    _, others, *vectors, faces = np.bincount(kinds, minlength=_FACE + 1).tolist()
    if faces > MAX_TRIANGLES:
        raise SceneError(f"{faces:,} faces are more than {MAX_TRIANGLES:,}: decimate it where it was made")
    if max(vectors) > 3 * MAX_TRIANGLES:
        raise SceneError(f"{max(vectors):,} vertices, texture coordinates or normals are more than "
                         f"{3 * MAX_TRIANGLES:,}: decimate it where it was made")  # fmt: skip
    if others > MAX_SINGLE_LINES:
        raise SceneError(f"{others:,} lines of groups, materials and the like are more than {MAX_SINGLE_LINES:,}: "
                         "join its groups")  # fmt: skip
    yield from Block(1, text, bounds, kinds).pieces(LINES)


def _kinds(text: UInt8[np.ndarray, " n"], starts: Int[np.ndarray, " lines"]) -> Int[np.ndarray, " lines"]:
    first, second, third = (text[np.minimum(starts + place, len(text) - 1)] for place in range(3))
    kinds = np.full(len(starts), _OTHER, np.int8)
    kinds[(first == ord("#")) | (first == ord("\n")) | (first == ord("\r")) & (second == ord("\n"))] = _NOTHING
    for kind, key in zip((*_VECTORS, _FACE), (*WIDTHS, b"f"), strict=True):
        kinds[(first == key[0]) & (SPACE[second] if len(key) == 1 else (second == key[-1]) & SPACE[third])] = kind
    return kinds
