"""Random queries, keys and values, and what a backend makes of them."""

import torch


def values_and_gradients(backend, q, k, v, pattern):
    leaves = [t.clone().requires_grad_() for t in (q, k, v)]
    out = backend(*leaves, pattern)
    weights = torch.linspace(-1, 1, out.numel(), device=out.device).view_as(out)
    (out.float() * weights).sum().backward()
    return [out.detach(), *(t.grad for t in leaves)]


def random_qkv(queries, keys, heads=2, dim=8, seed=0):
    g = torch.Generator().manual_seed(seed)
    return [torch.randn(n, heads, dim, generator=g) for n in (queries.total, keys.total, keys.total)]


def attend_loop(q, k, v, pattern):
    """The definition of attention, one segment at a time."""
    out = []
    queries, keys = pattern.queries.lengths, pattern.keys.lengths
    for qi, ki, vi in zip(q.split(queries), k.split(keys), v.split(keys), strict=True):
        weights = torch.einsum("qhd,khd->hqk", qi, ki) / qi.shape[-1] ** 0.5
        out.append(torch.einsum("hqk,khd->qhd", weights.softmax(-1), vi))
    return torch.cat(out)
