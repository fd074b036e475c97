"""Encode scenes object by object: in bounded memory, and after an edit only what changed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import torch
from jaxtyping import Float
from threadpoolctl import threadpool_limits
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.inference.bounded_cache import BoundedCache, digest_of
from rfpp.model.layers.scene_tokens import SceneTokens
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.raycast.threads import cores

#: Triangles encoded at a time on a GPU, which one object would leave idle; bounds the memory.
_GPU_TRIANGLES = 1 << 15
#: Triangles of an object from which matrix products use more than one core.
_MANY_TRIANGLES = 1 << 13


class ObjectEncoder:
    """View-independent stage of a network with object tokens, with a cache of objects.

    An object's tokens depend on its own triangles alone: positions, normals, reflectance, and emission in units of the
    scene's exposure. A digest of these is the key, so only objects new to the encoder are encoded. A moved object is
    encoded again, because rotary angles are those of world coordinates.

    On a CPU every object is encoded alone: sums inside a matrix product are ordered by its shape, so objects that share
    one would differ in their last bits from scene to scene. Small objects are encoded side by side, each on one core.
    On a GPU objects are encoded together, and tokens are equal up to rounding.

    Args:
        network: Network with object tokens, in evaluation mode, on `device`; its weights must not change afterwards.
        triangles_at_once: Triangles of objects that are encoded together; None chooses by the device.
    """

    def __init__(
        self,
        network: RenderFormerPP,
        device: torch.device,
        max_bytes: int = 256 << 20,
        triangles_at_once: int | None = None,
    ):
        self.network, self.device = network, device
        self._triangles_at_once = triangles_at_once or (1 if device.type == "cpu" else _GPU_TRIANGLES)
        self._cache: BoundedCache[SceneTokens] = BoundedCache(max_bytes)
        #: Number of objects encoded so far.
        self.encoded = 0

    def tokenize(self, batch: RaggedBatch) -> tuple[Float[Tensor, " b"], SceneTokens]:
        """Return exposure and tokens as `RenderFormerPP.tokenize`, for a batch on the CPU."""
        exposure = self.network.exposure(batch)
        tokens = SceneTokens.joined(self._each(batch.normalized(exposure)), batch.scenes.lengths)
        return exposure.to(self.device), tokens

    def _each(self, batch: RaggedBatch) -> list[SceneTokens]:
        """Return the tokens of every object of a batch on the CPU that is normalized to its exposure."""
        keys = object_keys(batch)
        tokens = {key: self._cache.get(key) for key in keys}
        missing = {key: number for number, key in enumerate(keys) if tokens[key] is None}
        chunks = list(batch.object_chunks(list(missing.values()), self._triangles_at_once))
        for numbers, encoded in zip(chunks, self._encoded(batch, chunks), strict=True):
            self.encoded += len(numbers)
            for number, part in zip(numbers, encoded, strict=True):
                tokens[keys[number]] = part
                self._cache.put(keys[number], part, _bytes(part))
        return [tokens[key] for key in keys]

    def _encoded(self, batch: RaggedBatch, chunks: Sequence[list[int]]) -> Iterator[list[SceneTokens]]:
        inference, dtype = torch.is_inference_mode_enabled(), torch.get_autocast_dtype(self.device.type)
        autocast = torch.is_autocast_enabled(self.device.type)

        def encode(numbers: list[int]) -> list[SceneTokens]:
            # modes are those of a thread
            with torch.inference_mode(inference), torch.autocast(self.device.type, dtype, enabled=autocast):
                return self.network.tokens(batch.only(numbers).to(self.device)).split(len(numbers))

        if self.device.type != "cpu":
            yield from map(encode, chunks)
            return
        small = [sum(batch.objects.lengths[number] for number in chunk) < _MANY_TRIANGLES for chunk in chunks]
        with ThreadPoolExecutor(cores(), "objects", initializer=_on_one_core) as pool:
            beside = [pool.submit(encode, chunk) for chunk, few in zip(chunks, small, strict=True) if few]
            waiting = iter(beside)
            for chunk, few in zip(chunks, small, strict=True):
                yield next(waiting).result() if few else encode(chunk)


def _on_one_core() -> None:
    """Limit PyTorch to one core in the calling thread; `torch.set_num_threads` would apply to all later ones."""
    threadpool_limits(1, user_api="openmp")


def object_keys(batch: RaggedBatch) -> list[bytes]:
    """Return a digest of each object's triangles, for a batch on the CPU."""
    arrays = [batch.positions, batch.normals, batch.material, *([] if batch.texture is None else [batch.texture])]
    arrays = [array.numpy() for array in arrays]
    return [digest_of(*(array[i:j] for array in arrays)) for i, j in pairwise(batch.objects.offsets.tolist())]


def _bytes(tokens: SceneTokens) -> int:
    return tokens.features.nbytes + tokens.points.nbytes + tokens.log_emission.nbytes
