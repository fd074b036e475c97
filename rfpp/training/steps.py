"""The differentiated part of a training step: executed as written, or captured as a CUDA graph."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import torch
from lightning.pytorch.utilities import rank_zero_info
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.func import functional_call

from rfpp.batch import RaggedBatch
from rfpp.cuda_graphs import CudaGraph
from rfpp.losses.rendering import RenderingLoss
from rfpp.model.layers.autocast import as_multiplied
from rfpp.model.layers.matrix_precision import block_weights
from rfpp.model.renderformer_pp import RenderFormerPP, Rendering


class StepResult(NamedTuple):
    """The loss under the name `loss`, each of its terms under its own, and the number of scene tokens."""

    terms: dict[str, Tensor]
    tokens: int


class PlainStep:
    """Network and loss of a batch, differentiated by autograd."""

    def __call__(self, network: RenderFormerPP, loss: RenderingLoss, batch: RaggedBatch) -> StepResult:
        return _losses(loss, network(batch), batch)


class CapturedStep:
    """Network, loss and backward pass as one CUDA graph for each shape of a batch (`RaggedBatch.padded`).

    A step of thousands of small kernels then takes as long as the GPU computes, not as long as the host launches. The
    backward pass runs with the forward pass; autograd is given its gradients.
    """

    def __init__(self) -> None:
        self._graphs: dict[tuple, _StepGraph] = {}

    def __call__(self, network: RenderFormerPP, loss: RenderingLoss, batch: RaggedBatch) -> StepResult:
        exposure = network.exposure(batch)
        batch = batch.normalized(exposure)
        if batch.shape not in self._graphs:
            begin = time.perf_counter()
            self._graphs[batch.shape] = _StepGraph(batch, exposure, self._memory(network, loss))
            rank_zero_info(
                f"captured the step of {len(batch.positions):,} triangles in {len(batch.objects):,} objects "
                f"in {time.perf_counter() - begin:.1f} s; it serves all batches of these padded sizes"
            )
        graph = self._graphs[batch.shape]
        terms = dict(zip(graph.names, graph.replay(batch, exposure), strict=True))
        return StepResult(
            terms | {"loss": _Differentiated.apply(terms["loss"], graph, *graph.parameters)}, graph.tokens
        )

    def _memory(self, network: RenderFormerPP, loss: RenderingLoss) -> _Memory:
        for graph in self._graphs.values():
            return graph.memory
        losses = _Losses(network, loss)
        trained = {name: p for name, p in losses.named_parameters() if p.requires_grad}
        gradients = torch.empty(sum(p.numel() for p in trained.values()), device=next(network.parameters()).device)
        return _Memory(torch.cuda.graph_pool_handle(), gradients, losses, trained, block_weights(losses))


class _Losses(nn.Module):
    """The loss of a network as a module, whose parameters can be replaced (`torch.func.functional_call`)."""

    def __init__(self, network: RenderFormerPP, loss: RenderingLoss):
        super().__init__()
        self.network, self.loss = network, loss

    def forward(self, batch: RaggedBatch, exposure: Tensor) -> StepResult:
        return _losses(self.loss, self.network.rendered(batch, exposure), batch)


class _Memory(NamedTuple):
    """Memory shared by all graphs: they are replayed one at a time, and their outputs read before the next."""

    pool: tuple[int, int]
    gradients: Tensor
    losses: _Losses
    trained: dict[str, nn.Parameter]
    block_weights: frozenset[str]


class _StepGraph:
    """The step of batches of one shape.

    Attributes:
        names: Names of the terms that `replay` returns.
        tokens: Scene tokens, with those of the padding.
        parameters: Parameters that the loss depends on.
        gradients: Their gradients of the last replay, flattened, one after the other.
    """

    def __init__(self, batch: RaggedBatch, exposure: Tensor, memory: _Memory):
        self.memory, self.gradients = memory, memory.gradients
        self.names: tuple[str, ...] = ()
        self.parameters: list[nn.Parameter] = []
        self.tokens = 0

        def step(exposure: Tensor, *tensors: Tensor) -> Tensor:
            # aliases, because autograd remembers the stream on which it first saw a parameter
            aliases = {name: p.detach().requires_grad_() for name, p in memory.trained.items()}
            # converted here, as the graph would convert them at each use: K + 1 times in the operator
            weights = {name: as_multiplied(p) if name in memory.block_weights else p for name, p in aliases.items()}
            inputs = batch.with_tensors(tensors), exposure
            terms, self.tokens = functional_call(memory.losses, weights, inputs)
            gradients = torch.autograd.grad(terms["loss"], list(aliases.values()), allow_unused=True)
            used = [(p, grad) for p, grad in zip(memory.trained.values(), gradients, strict=True) if grad is not None]
            self.names, self.parameters = tuple(terms), [p for p, _ in used]
            self.gradients = memory.gradients[: sum(p.numel() for p in self.parameters)]
            torch.cat([grad.flatten() for _, grad in used], out=self.gradients)
            return torch.stack([term.detach() for term in terms.values()])

        self._graph = CudaGraph(step, [exposure, *batch.tensors()], memory.pool)

    def replay(self, batch: RaggedBatch, exposure: Tensor) -> tuple[Tensor, ...]:
        """Compute the terms and gradients of a batch; return the terms."""
        return self._graph(exposure, *batch.tensors()).clone().unbind()


class _Differentiated(torch.autograd.Function):
    """The loss, as a function of parameters whose gradients are known."""

    @staticmethod
    def forward(ctx: Any, loss: Tensor, graph: _StepGraph, *_: Tensor) -> Tensor:
        ctx.graph = graph
        return loss.clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        parameters = ctx.graph.parameters
        pieces = (ctx.graph.gradients * grad).split([p.numel() for p in parameters])
        return None, None, *(piece.view_as(p) for piece, p in zip(pieces, parameters, strict=True))


def _losses(loss: RenderingLoss, rendering: Rendering, batch: RaggedBatch) -> StepResult:
    segments = rendering.token_segments
    terms = loss(rendering.log_radiance, rendering.transport_states, batch.image, segments, batch.token_light)
    return StepResult(terms, segments.total)
