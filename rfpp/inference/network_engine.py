"""Rendering with a network, RenderFormer++ or RenderFormer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Float

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.imaging.radiance import log_decode
from rfpp.inference.bounded_cache import digest_of
from rfpp.inference.captured import CapturedStages
from rfpp.inference.gbuffers import GBufferSource
from rfpp.inference.object_encoder import ObjectEncoder
from rfpp.inference.plan import Plan
from rfpp.model.hoct import ObjectTokens
from rfpp.model.layers.matrix_precision import convert_blocks
from rfpp.model.renderformer_pp import EncodedScenes, RenderFormerPP
from rfpp.scene.packed import PackedScene

Seen = TypeVar("Seen")


class NetworkEngine:
    """Engine of RenderFormer++ and RenderFormer; see `rfpp.inference.engine.Engine`.

    It caches the tokens of objects, the last scene's encoding, and first hits.

    Args:
        network: The network; its weights must not change afterwards, and most are converted to `dtype`.
    """

    is_linear, supersamples = False, False

    def __init__(self, network: RenderFormerPP, device: torch.device, dtype: torch.dtype):
        self.module = network.to(device).eval()
        convert_blocks(self.module, dtype)
        self.device, self.dtype = device, dtype
        self.patch_size, self.iterations = network.patch_size, network.iterations
        captured = device.type == "cuda" and dtype == torch.bfloat16
        self._captured = CapturedStages(network) if captured else None
        #: Encoder of single objects; None for a network whose tokens are triangles, and where all are encoded at once.
        by_object = isinstance(network.tokenizer, ObjectTokens) and not captured
        self.objects = ObjectEncoder(network, device) if by_object else None
        self._gbuffers = GBufferSource(network.gbuffer_channels)
        self._encoded: tuple[bytes, EncodedScenes] | None = None

    def views(
        self, plan: Plan, light: str | None = None, is_refined: bool = True
    ) -> Iterator[Float[np.ndarray, "h w 3"]]:
        """Yield the linear radiance of each camera; see `Engine.views`."""
        scene = plan.scene
        encoded = self._encode(scene, plan.transports)
        c2w, fov = (torch.from_numpy(x).to(self.device) for x in (scene.c2w, scene.fov))
        cast = self._gbuffers.of(scene, *plan.size, plan.light_samples)
        # on a CPU both would work on the same cores
        gbuffers = _computed_ahead(cast, len(fov)) if self.device.type != "cpu" else map(cast, range(len(fov)))
        for view, gbuffer in enumerate(gbuffers):
            seen = torch.from_numpy(gbuffer)[None, None].to(self.device)
            one = slice(view, view + 1)
            with torch.inference_mode(), self.autocast():
                stage = self._captured or self.module
                log_radiance = stage.view(encoded, c2w[None, one], fov[None, one], seen)
            yield log_decode(log_radiance)[0, 0].permute(1, 2, 0).clamp_min(0).cpu().numpy()

    def autocast(self) -> torch.autocast:
        """Return the context in which matrix products have the engine's type."""
        return torch.autocast(self.device.type, self.dtype, enabled=self.dtype != torch.float32)

    def _encode(self, scene: PackedScene, transports: int | None) -> EncodedScenes:
        triangles = scene.triangles
        arrays = [triangles.positions, triangles.normals, triangles.material, triangles.object_offsets]
        key = digest_of(*arrays, np.array(-1 if transports is None else transports))
        if scene.texture is not None:
            key += digest_of(scene.texture)
        if self._encoded is None or self._encoded[0] != key:
            with torch.inference_mode(), self.autocast():
                self._encoded = key, self._transported(_batch(scene), transports)
        return self._encoded[1]

    def _transported(self, batch: RaggedBatch, transports: int | None) -> EncodedScenes:
        if self._captured:
            return self._captured.encode(batch.padded().to(self.device), transports)
        source = self.module if self.objects is None else self.objects
        exposure, tokens = source.tokenize(batch if self.objects else batch.to(self.device))
        if transports is None:
            return self.module.transported(exposure, tokens)
        return self.module.transported_each(exposure, tokens, transports)[0][-1]


def _batch(scene: PackedScene) -> RaggedBatch:
    no_gbuffer = np.zeros((len(scene.fov), 0, 0, 0), np.float32)
    views = SceneViews(scene.name, scene.triangles, scene.c2w, scene.fov, no_gbuffer, texture=scene.texture)
    return RaggedBatch.pack([views])


def _computed_ahead(cast: Callable[[int], Seen], count: int) -> Iterator[Seen]:
    """Yield `cast` of 0 … count - 1, each computed in a thread while the one before is in use."""
    with ThreadPoolExecutor(1, "gbuffer") as beside:
        upcoming = beside.submit(cast, 0)
        for view in range(count):
            seen = upcoming.result()
            if view + 1 < count:
                upcoming = beside.submit(cast, view + 1)
            yield seen
