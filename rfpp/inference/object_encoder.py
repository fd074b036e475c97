"""Scenes encoded object by object: in bounded memory, and after an edit only what was edited."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from hashlib import blake2b
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float
from threadpoolctl import threadpool_limits
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.gbuffer.threads import cores
from rfpp.inference.bounded_cache import BoundedCache
from rfpp.model.renderformer_pp import EncodedScenes, RenderFormerPP
from rfpp.model.tokenizer import SceneTokens, mean_by_object
from rfpp.scene.triangles import EMISSION

#: Triangles encoded at a time on a GPU, which one object would leave idle; this many bound the memory.
_GPU_TRIANGLES = 1 << 15
#: Triangles of an object whose matrix products are worth more than one core.
_MANY_TRIANGLES = 1 << 13


class ObjectEncoder:
    """The view-independent stage of a network with object tokens, which keeps the tokens of objects it has seen.

    An object's tokens depend on nothing but its own triangles: where they are, their normals, their reflectance, and
    what they emit in units of the scene's exposure. These numbers are the key, so whatever is edited, added or put in
    another order, only objects that are new to the encoder are encoded. A changed light changes the exposure and with
    it what every emitter emits, if the network reads that; other objects emit nothing in any unit and stay. A moved
    object is encoded again: its tokens are those of its old place up to rounding only, because the rotary angles are
    those of world coordinates.

    On a CPU every object is encoded alone. The sums inside a matrix product are ordered by its shape, so tokens of
    objects that share one differ in the last bits with the company; alone, they are the same bits in every scene. Small
    objects are encoded side by side, each on one core: their products are too short to be divided. On a GPU objects are
    encoded together and the tokens are the same up to rounding.

    Args:
        network: with object tokens, in evaluation mode, on `device`; its weights must not change from here on.
        device: of the network.
        max_bytes: of the tokens that are kept.
        triangles_at_once: objects are encoded together up to so many, larger ones alone; None chooses by the device.
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
        self._kept: BoundedCache[SceneTokens] = BoundedCache(max_bytes)
        #: Objects encoded so far.
        self.encoded = 0

    def encode(self, batch: RaggedBatch) -> EncodedScenes:
        """As `RenderFormerPP.encode`.

        Args:
            batch: on the CPU.
        """
        return self.network.transported(*self.tokenize(batch))

    def tokenize(self, batch: RaggedBatch) -> tuple[Float[Tensor, " b"], SceneTokens]:
        """As `RenderFormerPP.tokenize`, for a batch on the CPU."""
        exposure = self.network.exposure(batch)
        batch = batch.dimmed(exposure)
        whole = SceneTokens.joined(self.each(batch), batch.scenes.lengths)
        return exposure.to(self.device), self.network.source(whole, batch)

    def each(self, batch: RaggedBatch) -> list[SceneTokens]:
        """The tokens of every object.

        Args:
            batch: on the CPU, at its exposure.
        """
        keys = object_keys(batch, self.network.tokenizer.reads, self.network.embedding.reads_emission)
        tokens = {key: self._kept.get(key) for key in keys}
        missing = {key: number for number, key in enumerate(keys) if tokens[key] is None}
        chunks = list(batch.object_chunks(list(missing.values()), self._triangles_at_once))
        for numbers, made in zip(chunks, self._made(batch, chunks), strict=True):
            self.encoded += len(numbers)
            for number, part in zip(numbers, made, strict=True):
                tokens[keys[number]] = part
                self._kept.put(keys[number], part, _bytes(part))
        # an object with the same tokens may be brighter than it was
        emitted = mean_by_object(batch.log_emission, batch).to(self.device)
        return [
            replace(tokens[key], log_light=of_object.expand(len(tokens[key].log_light), 3))
            for key, of_object in zip(keys, emitted, strict=True)
        ]

    def _made(self, batch: RaggedBatch, chunks: Sequence[list[int]]) -> Iterator[list[SceneTokens]]:
        """The tokens of each object of each chunk."""
        inference, dtype = torch.is_inference_mode_enabled(), torch.get_autocast_dtype(self.device.type)
        autocast = torch.is_autocast_enabled(self.device.type)

        def make(numbers: list[int]) -> list[SceneTokens]:
            # modes are those of a thread
            with torch.inference_mode(inference), torch.autocast(self.device.type, dtype, enabled=autocast):
                return self.network.tokens(batch.only(numbers).to(self.device)).split(len(numbers))

        if self.device.type != "cpu":
            yield from map(make, chunks)
            return
        small = [sum(batch.objects.lengths[number] for number in chunk) < _MANY_TRIANGLES for chunk in chunks]
        with ThreadPoolExecutor(cores(), "objects", initializer=_on_one_core) as pool:
            beside = [pool.submit(make, chunk) for chunk, few in zip(chunks, small, strict=True) if few]
            waiting = iter(beside)
            for chunk, few in zip(chunks, small, strict=True):
                yield next(waiting).result() if few else make(chunk)


def _on_one_core() -> None:
    """PyTorch's products in the calling thread from here on; `torch.set_num_threads` would be for all to come."""
    threadpool_limits(1, user_api="openmp")


def object_keys(batch: RaggedBatch, reads: Collection[str] = (), emission: bool = True) -> list[bytes]:
    """A digest of everything an object's encoder sees, for each object of a batch on the CPU.

    Args:
        reads: of the tokenizer.
        emission: whether it sees what is emitted.
    """
    material = batch.material if emission else batch.material[:, : EMISSION.start]
    arrays = [batch.positions, batch.normals, material, *([] if batch.texture is None else [batch.texture])]
    arrays = [np.ascontiguousarray(array.numpy()) for array in arrays]
    octants = batch.octants.numpy().reshape(-1, 8, 3) if "cells" in reads else None
    keys = []
    for number, (first, last) in enumerate(pairwise(batch.objects.offsets.tolist())):
        digest = blake2b(b"" if octants is None else octants[number].tobytes(), digest_size=16)
        for array in arrays:
            digest.update(array[first:last])
        keys.append(digest.digest())
    return keys


def _bytes(tokens: SceneTokens) -> int:
    return tokens.features.nbytes + tokens.points.nbytes + tokens.log_light.nbytes
