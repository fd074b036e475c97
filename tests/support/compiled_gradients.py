"""Compiled against plain blocks, in a process without the tests' type checks, which a compiler cannot trace."""

from functools import partial

import numpy as np
import torch
from networks import network
from random_scenes import random_views

from rfpp.batch import RaggedBatch
from rfpp.model.layers import attention
from rfpp.training import blocks

#: Triangles of the objects of the scenes of each batch.
BATCHES = ([(14, 6, 1), (9, 1)], [(40, 11, 5, 1)], [(7, 1), (8, 8, 1), (23, 1)])


def gradients(net: torch.nn.Module, batch: RaggedBatch) -> dict[str, torch.Tensor]:
    net.zero_grad()
    net(batch).log_radiance.square().mean().backward()
    return {name: p.grad.clone() for name, p in net.named_parameters() if p.grad is not None}


def batches() -> list[RaggedBatch]:
    rng = np.random.default_rng(0)
    return [RaggedBatch.pack([random_views(rng, sizes) for sizes in each]) for each in BATCHES]


def compare() -> tuple[list[float], list[int]]:
    """After each batch: the largest relative difference of a gradient, and how much has been compiled so far."""
    from torch._dynamo.testing import CompileCounterWithBackend

    counter = CompileCounterWithBackend("aot_eager")  # the tracing is ours to get right; machine code takes a minute
    torch.compile = partial(torch.compile, backend=counter)
    attention.attend_bucketed = torch.compiler.disable(attention.attend_bucketed)  # stands for a GPU's fused kernel
    net, compiled = (network("experiment=large_scale", "size=tiny").train() for _ in range(2))
    blocks.compile_blocks(compiled)
    differences, compilations = [], []
    for batch in batches():
        expected, found = gradients(net, batch), gradients(compiled, batch)
        differences.append(max(float((found[k] - g).norm() / g.norm().clamp(min=1e-12)) for k, g in expected.items()))
        compilations.append(counter.frame_count)
    return differences, compilations
