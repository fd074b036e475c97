"""Compiled blocks on a GPU, in a process without type checks, which a compiler cannot trace."""

from functools import partial

import torch
from compiled_gradients import batches
from fake_gpu import network_on
from network_variants import batch_for, loss

from rfpp.training.blocks import compile_blocks
from rfpp.training.steps import CapturedStep, PlainStep


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


def captured_against_plain(
    overrides: tuple[str, ...], scenes: list[tuple[tuple[int, ...], ...]], compiled: bool
) -> tuple[dict[str, list[float]], int]:
    """Relative differences of loss and gradients of each batch, and how many graphs were captured."""
    torch.manual_seed(0)
    plain = network_on("cuda", *overrides).train()
    other = network_on("cuda", *overrides).train()
    other.load_state_dict(plain.state_dict())
    if compiled:
        compile_blocks(other)
    captured, differences = CapturedStep(), {"losses": [], "gradients": []}
    for sizes in scenes:
        batch = batch_for(plain, resolution=32, sizes=sizes)
        found = _step(captured, other, batch.padded().to("cuda"))
        expected = _step(PlainStep(), plain, batch.to("cuda"))
        for kind, a, b in zip(differences, found, expected, strict=True):
            differences[kind].append(float((a - b).norm() / b.norm()))
    return differences, len(captured._graphs)


def _step(step, net: torch.nn.Module, batch) -> tuple[torch.Tensor, torch.Tensor]:
    net.zero_grad()
    with torch.autocast("cuda", torch.bfloat16):
        terms, _ = step(net, loss(), batch)
    (2 * terms["loss"]).backward()
    return terms["loss"].detach(), torch.cat([p.grad.flatten() for p in net.parameters() if p.grad is not None])


def _gradients(net: torch.nn.Module, batch) -> torch.Tensor:
    net.zero_grad()
    with torch.autocast("cuda", torch.bfloat16):
        net(batch).log_radiance.square().mean().backward()
    return torch.cat([p.grad.flatten() for p in net.parameters() if p.grad is not None])
