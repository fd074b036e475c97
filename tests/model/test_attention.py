"""The fast attention backends against the loop that defines them, in values and gradients."""

import numpy as np
import torch
from attention_inputs import attend_loop, random_qkv, values_and_gradients
from hypothesis import given, settings
from hypothesis import strategies as st

from rfpp.model.layers.attention import AttentionPattern, attend_bucketed
from rfpp.segments import Segments


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 9), st.integers(1, 40)), min_size=1, max_size=8))
def test_buckets_equal_loop_for_any_lengths(lengths):
    queries, keys = (Segments.from_lengths(n) for n in zip(*lengths, strict=True))
    qkv, pattern = [values.double() for values in random_qkv(queries, keys)], AttentionPattern(queries, keys)
    for fast, slow in zip(
        values_and_gradients(attend_bucketed, *qkv, pattern),
        values_and_gradients(attend_loop, *qkv, pattern),
        strict=True,
    ):
        torch.testing.assert_close(fast, slow, rtol=1e-10, atol=1e-12)


def test_segments_do_not_leak():
    segments = Segments.from_lengths([5, 7, 3])
    (q, k, v), pattern = random_qkv(segments, segments), AttentionPattern(segments)
    before = attend_bucketed(q, k, v, pattern)
    k[5:12], v[5:12] = 100.0, 100.0  # only segment 1 may notice
    after = attend_bucketed(q, k, v, pattern)
    assert torch.equal(before[:5], after[:5])
    assert torch.equal(before[12:], after[12:])
    assert not torch.allclose(before[5:12], after[5:12])


def test_buckets_bound_the_padding():
    lengths = np.random.default_rng(0).integers(100, 1200, 70).tolist()
    pattern = AttentionPattern(Segments.from_lengths(lengths))
    padded = sum(b.key_rows.size for b in pattern.buckets)
    assert padded <= 1.05 * sum(lengths)


def test_shapes_recur_between_batches():
    rng = np.random.default_rng(1)
    shapes = set()
    for _ in range(50):
        pattern = AttentionPattern(Segments.from_lengths(rng.integers(1, 301, rng.integers(20, 90)).tolist()))
        shapes |= {b.key_rows.shape for b in pattern.buckets}
    assert len(shapes) < 80  # of the thousands of lengths and counts that occurred
