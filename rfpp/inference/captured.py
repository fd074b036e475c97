"""A network's two stages on a GPU as CUDA graphs: a picture takes as long as the GPU computes."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.cuda_graphs import CudaGraph, Result
from rfpp.model.layers.scene_tokens import SceneTokens
from rfpp.model.renderformer_pp import EncodedScenes, RenderFormerPP


class CapturedStages:
    """Encoding and views of a network, with a graph for each padded size of a scene and each resolution.

    The first time, a size is computed without a graph, whose capture takes as long as three pictures.

    Args:
        network: Network in evaluation mode on a GPU, in half precision; its weights must not change afterwards.
    """

    def __init__(self, network: RenderFormerPP):
        self.network = network
        self._pool = torch.cuda.graph_pool_handle()
        self._graphs: dict[Hashable, CudaGraph | None] = {}

    def encode(self, batch: RaggedBatch, transports: int | None = None) -> EncodedScenes:
        """Run the view-independent stage on scenes on the GPU, as `RaggedBatch.padded` returns them.

        Args:
            transports: Applications of the operator; None for the network's own number.
        """
        exposure = self.network.exposure(batch)
        batch = batch.normalized(exposure)

        def encode(exposure: Tensor, *tensors: Tensor) -> SceneTokens:
            tokens = self.network.tokens(batch.with_tensors(tensors))
            if transports is None:
                return self.network.transported(exposure, tokens).tokens
            return self.network.transported_each(exposure, tokens, transports)[0][-1].tokens

        tokens = self._computed((batch.shape, transports), encode, exposure, *batch.tensors())
        copies = {name: getattr(tokens, name).clone() for name in ("features", "points", "log_emission")}
        segments = replace(tokens.segments, offsets=tokens.segments.offsets.clone())
        return EncodedScenes(replace(tokens, **copies, segments=segments), exposure, ())

    def view(
        self,
        scenes: EncodedScenes,
        c2w: Float[Tensor, "b v 4 4"],
        fov: Float[Tensor, "b v"],
        gbuffer: Float[Tensor, "b v c h w"],
    ) -> Float[Tensor, "b v 3 h w"]:
        """Run the view-dependent stage on scenes that `encode` returned; see `RenderFormerPP.view`."""
        tokens = scenes.tokens

        def view(features: Tensor, points: Tensor, offsets: Tensor, exposure: Tensor, *seen: Tensor) -> Tensor:
            segments = replace(tokens.segments, offsets=offsets)
            of_graph = replace(tokens, features=features, points=points, segments=segments)
            return self.network.view(EncodedScenes(of_graph, exposure, ()), *seen)

        inputs = (tokens.features, tokens.points, tokens.segments.offsets, scenes.exposure, c2w, fov, gbuffer)
        key = (*(tuple(x.shape) for x in inputs), tokens.segments.longest)
        return self._computed(key, view, *inputs).clone()

    def _computed(self, key: Hashable, function: Callable[..., Result], *inputs: Tensor) -> Result:
        if key not in self._graphs:
            self._graphs[key] = None
            return function(*inputs)
        graph = self._graphs[key]
        if graph is None:
            graph = self._graphs[key] = CudaGraph(function, inputs, self._pool)
        result: Result = graph(*inputs)
        return result
