"""Attention in tiles against its definition, in values and gradients, where there are many tiles of several heads."""

import pytest
import torch
from attention_inputs import attend_loop, random_qkv, values_and_gradients

from rfpp.model.layers import attention, tiled_attention
from rfpp.model.layers.attention import AttentionPattern, attend_bucketed
from rfpp.model.layers.tiled_attention import attend_tiled
from rfpp.segments import Segments


def tiled(q, k, v, real):
    """Attend within one segment [n, h, d], with the layout of `attend_loop`."""
    return attend_tiled(*(x.transpose(0, 1) for x in (q, k, v)), real).transpose(0, 1)


@pytest.mark.parametrize(("queries", "keys"), [(1, 1), (9, 1), (1, 37), (37, 37), (64, 5)])
def test_many_tiles_equal_the_definition(queries, keys, monkeypatch):
    monkeypatch.setattr(tiled_attention, "TILE", 150)
    monkeypatch.setattr(tiled_attention, "_QUERIES", 8)
    monkeypatch.setattr(tiled_attention, "_FEWEST_QUERIES", 3)
    segments = Segments.from_lengths([queries]), Segments.from_lengths([keys])
    qkv = random_qkv(*segments, heads=5)
    for fast, slow in zip(
        values_and_gradients(tiled, *qkv, None),
        values_and_gradients(attend_loop, *qkv, AttentionPattern(*segments)),
        strict=True,
    ):
        torch.testing.assert_close(fast, slow, rtol=1e-5, atol=1e-6)


def test_a_scene_in_bfloat16_equals_the_definition_as_far_as_eight_bits_go(monkeypatch):
    monkeypatch.setattr(attention, "SMALL_ATTENTION", 32 * 32)
    used = []
    apply = attention.attend_tiled
    monkeypatch.setattr(attention, "attend_tiled", lambda *args: used.append(args[-1] is not None) or apply(*args))
    segments = Segments.from_lengths([128, 128, 300, 51, 64, 1, 30, 77])
    qkv, pattern = [x.bfloat16() for x in random_qkv(segments, segments, dim=64)], AttentionPattern(segments)
    for fast, slow in zip(
        values_and_gradients(attend_bucketed, *qkv, pattern),
        values_and_gradients(attend_loop, *[x.float() for x in qkv], pattern),
        strict=True,
    ):
        assert (fast.float() - slow).norm() < 0.01 * slow.norm()
    assert set(used) == {True, False}  # with padding and without


def test_there_is_never_more_than_a_tile_of_scores():
    q, k = torch.empty(12, 4096, 8, device="meta"), torch.empty(12, 30_000, 8, device="meta")
    seen = torch.zeros(12, 4096)
    for heads, tiles in tiled_attention._tiles(q, k):
        for rows in tiles:
            assert seen[heads, rows].numel() * k.shape[1] <= tiled_attention.TILE
            seen[heads, rows] += 1
    assert (seen == 1).all()
