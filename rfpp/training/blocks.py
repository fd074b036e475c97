"""Compilation and activation checkpointing of transformer blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.model.dpt import DPTHead
from rfpp.model.hoct import ObjectTokens
from rfpp.model.layers.block import CrossBlock, SelfBlock
from rfpp.model.layers.scene_tokens import SceneTokens
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.model.view_decoder import DecoderBlock


def compile_blocks(network: nn.Module) -> None:
    """Compile every block for any number of tokens, and the image head; without gradients they run as they are.

    Blocks of one kind share their compiled code. For GPUs in bfloat16, whose attention is a fused kernel: elsewhere
    it is planned with NumPy, which cannot be compiled.
    """
    for block in _blocks(network):
        block.forward = _in_training(block.forward, torch.compile(block.forward, dynamic=True))
    for part in network.modules():
        if isinstance(part, DPTHead):
            part.forward = _in_training(part.forward, torch.compile(part.forward))


def _in_training(plain: Callable[..., Tensor], compiled: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Run compiled code in training alone: compiling for validation costs more than it saves."""

    def forward(*inputs: Any) -> Tensor:
        return (compiled if torch.is_grad_enabled() else plain)(*inputs)

    return forward


class RecomputedBlocks:
    """Activation checkpointing of each block: its activations are recomputed in the backward pass."""

    def __call__(self, network: nn.Module) -> None:
        """Change a network's blocks; call it after `compile_blocks`."""
        for block in _blocks(network):
            _recompute(block)


class RecomputedObjects:
    """Activation checkpointing with minimal memory: a few objects at a time in the encoder, then block by block.

    Only the tokens of an object stay in memory. For networks with object tokens.

    Args:
        triangles: Maximum number of triangles encoded at a time; larger objects are encoded alone.
    """

    def __init__(self, triangles: int):
        self.triangles = triangles

    def __call__(self, network: RenderFormerPP) -> None:
        """Change a network; call it after `compile_blocks`.

        Raises:
            UserError: If the network has no object tokens.
        """
        if not isinstance(network.tokenizer, ObjectTokens):
            raise UserError("activation_checkpointing=objects: this network has no object tokens: choose blocks")
        inside = set(network.tokenizer.modules())
        for block in _blocks(network):
            if block not in inside:
                _recompute(block)
        network.tokens = partial(self._tokens, network.tokens)

    def _tokens(self, make: Callable[[RaggedBatch], SceneTokens], batch: RaggedBatch) -> SceneTokens:
        chunks = batch.object_chunks(range(len(batch.objects)), self.triangles)
        parts = [checkpoint(make, batch.only(numbers), use_reentrant=False) for numbers in chunks]
        return SceneTokens.joined(parts, batch.scenes.lengths)


def _recompute(block: nn.Module) -> None:
    block.forward = partial(checkpoint, block.forward, use_reentrant=False)


def _blocks(network: nn.Module) -> Iterator[nn.Module]:
    return (part for part in network.modules() if isinstance(part, SelfBlock | CrossBlock | DecoderBlock))
