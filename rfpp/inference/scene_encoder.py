"""The view-independent stage of a network: a scene's tokens, and the light that has moved between them."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.inference.digest import digest_of
from rfpp.inference.object_encoder import ObjectEncoder
from rfpp.inference.plan import Plan
from rfpp.model.renderformer_pp import EncodedScenes
from rfpp.model.tokenizer import ObjectTokens, SceneTokens

Encoded = TypeVar("Encoded")


class SceneEncoder:
    """Encodes scenes, and keeps what the last one was encoded to, which serves its next view.

    Args:
        network: in evaluation mode, on `device`; its weights must not change from here on.
        dtype: of matrix products.
    """

    def __init__(self, network: nn.Module, device: torch.device, dtype: torch.dtype):
        self.network, self.device, self.dtype = network, device, dtype
        #: What encodes object by object; None for a network whose tokens are triangles.
        self.objects = ObjectEncoder(network, device) if isinstance(network.tokenizer, ObjectTokens) else None
        self._kept: tuple[Hashable, Any] = (None, None)

    def autocast(self) -> torch.autocast:
        """Of matrix products."""
        return torch.autocast(self.device.type, self.dtype, enabled=self.dtype != torch.float32)

    def encode(self, batch: RaggedBatch, plan: Plan, light: str | None) -> EncodedScenes:
        """After as many applications of the transport operator as are planned.

        Args:
            batch: the scene of the plan, on the CPU.
            light: see `Renderer.views`.
        """
        if plan.transports is not None:
            return self.encode_each(batch, plan, light)[-1]
        return self._once("whole", plan, light, lambda: self.network.transported(*self._tokenize(batch)))

    def encode_each(self, batch: RaggedBatch, plan: Plan, light: str | None) -> list[EncodedScenes]:
        """After k = 0 … applications."""
        count = self.network.iterations if plan.transports is None else plan.transports
        return self._once(count, plan, light, lambda: self.network.transported_each(*self._tokenize(batch), count)[0])

    def _once(self, what: str | int, plan: Plan, light: str | None, encode: Callable[[], Encoded]) -> Encoded:
        triangles, texture = plan.scene.triangles, plan.scene.texture
        seen = [triangles.positions, triangles.normals, triangles.material, triangles.object_offsets]
        key = (what, light, digest_of(*seen, *(() if texture is None else (texture,))))
        kept, encoded = self._kept
        if kept != key:
            with torch.inference_mode(), self.autocast():
                encoded = encode()
            self._kept = key, encoded
        return encoded

    def _tokenize(self, batch: RaggedBatch) -> tuple[Float[Tensor, " b"], SceneTokens]:
        if self.objects is None:
            return self.network.tokenize(batch.to(self.device))
        return self.objects.tokenize(batch)
