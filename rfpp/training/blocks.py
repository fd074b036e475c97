"""Time and memory of a network's transformer blocks: compiled, or their activations computed twice."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import torch
from torch import nn
from torch.utils.checkpoint import checkpoint

from rfpp.model.block import CrossBlock, SelfBlock
from rfpp.model.view_decoder import DecoderBlock


def compile_blocks(network: nn.Module) -> None:
    """Compile every block, once for all numbers of tokens.

    Blocks of one kind share their code, and what surrounds them, the planning of ragged attention, is no matter for a
    compiler.
    """
    for block in _blocks(network):
        block.forward = torch.compile(block.forward, dynamic=True)


def checkpoint_activations(network: nn.Module) -> None:
    """Let every block forget its activations and compute them again in the backward pass. After `compile_blocks`."""
    for block in _blocks(network):
        block.forward = partial(checkpoint, block.forward, use_reentrant=False)


def _blocks(network: nn.Module) -> Iterator[nn.Module]:
    return (part for part in network.modules() if isinstance(part, SelfBlock | CrossBlock | DecoderBlock))
