"""Compiled blocks on a GPU, in a process without type checks, which a compiler cannot trace."""

from functools import partial

import torch
from compiled_gradients import batches
from fake_gpu import network_on

from rfpp.training.blocks import compile_blocks


def compile_whole_blocks(overrides: tuple[str, ...]) -> tuple[list[float], list[int]]:
    """After each batch: how far compiled gradients are from plain ones, and how much has been compiled so far.

    A block that does not compile as a whole is an error.
    """
    from torch._dynamo.testing import CompileCounterWithBackend

    counter = CompileCounterWithBackend("inductor")
    torch.compile = partial(torch.compile, backend=counter, fullgraph=True)
    plain = network_on("cuda", *overrides).train()
    compiled = network_on("cuda", *overrides).train()
    compiled.load_state_dict(plain.state_dict())
    compile_blocks(compiled)
    differences, compilations = [], []
    for batch in batches():
        expected, found = (_gradients(net, batch.to("cuda")) for net in (plain, compiled))
        differences.append(float((found - expected).norm() / expected.norm()))
        compilations.append(counter.frame_count)
    return differences, compilations


def _gradients(net: torch.nn.Module, batch) -> torch.Tensor:
    net.zero_grad()
    with torch.autocast("cuda", torch.bfloat16):
        net(batch).log_radiance.square().mean().backward()
    return torch.cat([p.grad.flatten() for p in net.parameters() if p.grad is not None])
