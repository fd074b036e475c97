"""CUDA graphs: a function's kernels, launched as one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import torch
from torch import Tensor

#: Executions before the capture, in which kernels are compiled and chosen and their workspaces allocated.
_WARM_UP = 2

Result = TypeVar("Result")


class CudaGraph(Generic[Result]):
    """A captured function of tensors, replayed on other values of the same shapes.

    Args:
        function: Returns something made of tensors; reads nothing from the device, and copies nothing to it.
        inputs: First values, on the GPU.
        pool: Memory that graphs share (`torch.cuda.graph_pool_handle`). Each replay may overwrite the results of
            every graph of the pool.
    """

    def __init__(self, function: Callable[..., Result], inputs: Sequence[Tensor], pool: tuple[int, int]):
        self._inputs = [tensor.clone() for tensor in inputs]
        # without the cache, which would keep weights that were converted in the graph's own memory
        autocast = torch.autocast(
            "cuda", torch.get_autocast_dtype("cuda"), torch.is_autocast_enabled("cuda"), cache_enabled=False
        )
        with autocast:
            before = torch.cuda.Stream()
            before.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(before):
                for _ in range(_WARM_UP):
                    function(*self._inputs)
            torch.cuda.current_stream().wait_stream(before)
            self._graph = torch.cuda.CUDAGraph()
            # other threads copy batches and wait for communication meanwhile
            with torch.cuda.graph(self._graph, pool, capture_error_mode="thread_local"):
                self._result = function(*self._inputs)

    def __call__(self, *inputs: Tensor) -> Result:
        """Return the result, valid until the next replay of a graph of the pool."""
        for static, tensor in zip(self._inputs, inputs, strict=True):
            static.copy_(tensor, non_blocking=True)
        self._graph.replay()
        return self._result
