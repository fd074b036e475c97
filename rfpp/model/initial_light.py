"""What starts the transport: the light that scene tokens have before any of it has moved."""

from __future__ import annotations

from dataclasses import replace

from rfpp.batch import RaggedBatch
from rfpp.errors import UserError
from rfpp.imaging.radiance import log_encode
from rfpp.model.tokenizer import SceneTokens


class EmittedLight:
    """L_e, what the tokens emit (paper, Sec. 3.1). Most emit nothing."""

    #: What batches must carry besides triangles.
    reads: tuple[str, ...] = ()

    def __call__(self, tokens: SceneTokens, batch: RaggedBatch) -> SceneTokens:
        return tokens


class FirstBounce:
    """T L_e instead: what objects send on of the light that the emitters send them. For tokens of objects.

    Not in the paper. The series starts one term later: how lights, shadows and albedos make an object bright is
    computed (`rfpp.gbuffer.object_light`), so that every token starts with light and the network has to move it on.
    What the emitters send to the surfaces that a camera sees must then be in the G-buffer.
    """

    reads = ("object_light",)
    #: Radiance, in units of the exposure, below which differences fade.
    FLOOR = 0.01

    def __call__(self, tokens: SceneTokens, batch: RaggedBatch) -> SceneTokens:
        """Raises ValueError where the batch does not carry `object_light`, or tokens do not stand for objects."""
        if batch.object_light is None:
            raise ValueError("the network starts from the first bounce, but the batch carries no object_light")
        per_object = len(tokens.features) // len(batch.objects)
        if tokens.segments.lengths != tuple(per_object * objects for objects in batch.scenes.lengths):
            raise ValueError("the first bounce is known of objects, and these tokens stand for something else")
        light = log_encode(batch.object_light.to(tokens.log_light) / self.FLOOR)
        return replace(tokens, log_light=light.repeat_interleave(per_object, dim=0))


class CellLight:
    """T L_e of every cell, shadows included, in place of L_e: for `LinearTransport`.

    Not in the paper. What the emitters send to the surfaces that a camera sees must then be in the G-buffer.
    """

    reads: tuple[str, ...] = ("cells",)

    def __call__(self, tokens: SceneTokens, batch: RaggedBatch) -> SceneTokens:
        """Raises ValueError where the batch does not carry cells, UserError where tokens do not stand for octants."""
        if batch.cells is None:
            raise ValueError("the network moves light between cells, but the batch carries none")
        if tokens.segments.lengths != tuple(8 * objects for objects in batch.scenes.lengths):
            raise UserError("cells belong to octants of objects: give the network eight tokens an object (queries: 8)")
        cells = batch.cells.to(tokens.features.device)  # a renderer encodes objects of a batch that stays on the host
        return replace(tokens, cells=cells, bounces=batch.bounces)
