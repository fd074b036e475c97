"""Texels are where the parts of divided triangles are, and follow their triangles."""

import numpy as np

from rfpp.raycast.texel_lookup import texel_at
from rfpp.scene.io.pieces import Pieces
from rfpp.scene.texels import Texels, rows_of

RNG = np.random.default_rng(0)
CORNERS = RNG.normal(size=(3, 3, 3))
LEVELS = np.array([2, 0, 3], np.int8)


def numbered(levels: np.ndarray = LEVELS, start: int = 0) -> Texels:
    """Texels whose first column is the number of their row."""
    counts = rows_of(levels)
    values = np.zeros((counts.sum(), 10), np.float32)
    values[:, 0] = start + np.arange(len(values))
    return Texels(levels, np.cumsum(counts) - counts, values)


def test_a_texel_is_the_part_that_holds_the_point():
    weights = RNG.dirichlet((1, 1, 1), 200)
    for level in range(1, 4):
        parts = Pieces.whole(CORNERS[:1])
        for _ in range(level):
            parts = parts.quartered()
        for _, u, v in weights:
            row = texel_at(np.array([level], np.int8), np.array([100]), 0, u, v, 1.0, 0.0)
            part = parts.weights[row - 100 - (rows_of(np.array([level]))[0] - 4**level)]
            assert (np.linalg.solve(part.T, [1 - u - v, u, v]) >= -1e-9).all()


def test_a_texel_is_no_smaller_than_what_is_seen():
    levels, first = np.array([3], np.int8), np.array([0])
    rows = [texel_at(levels, first, 0, 0.3, 0.3, 1.0, footprint) for footprint in (2.0, 1.0, 0.9, 0.2, 0.06, 1e-9)]
    assert rows[:2] == [-1, -1]
    assert [np.searchsorted([4, 20, 84], row, side="right") for row in rows[2:]] == [0, 1, 2, 2]


def test_texels_follow_their_triangles():
    whole = numbered()
    for chosen in (np.array([2, 0]), np.array([True, False, True]), np.array([1])):
        part = whole.only(chosen)
        assert len(part.values) == rows_of(part.level).sum()
        for new, old in enumerate(np.arange(3)[chosen]):
            own = np.arange(rows_of(part.level)[new])
            expected = whole.values[whole.first[old] + own]
            np.testing.assert_array_equal(part.values[part.first[new] + own], expected)


def test_meshes_with_and_without_texels_are_joined():
    assert Texels.of_all([(None, 2), (None, 1)]) is None
    joined = Texels.of_all([(numbered(), 3), (None, 2), (numbered(LEVELS[:1], start=1000), 1)])
    np.testing.assert_array_equal(joined.level, [2, 0, 3, 0, 0, 2])
    assert joined.values[joined.first[2], 0] == rows_of(LEVELS[:2]).sum()
    assert joined.values[joined.first[5], 0] == 1000


def test_equal_texels_have_equal_digests():
    assert numbered().digest == numbered().digest
    assert numbered().digest != numbered(start=1).digest
