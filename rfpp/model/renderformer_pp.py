"""RenderFormer++: the stages in the order of the paper's pipeline figure."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.model.tokenizer import ObjectTokens, TriangleTokens
from rfpp.model.transport import PhysicsInformedTransport, Transported, UnconstrainedTransport
from rfpp.model.triangle_embedding import TriangleEmbedding
from rfpp.model.view_decoder import ViewDecoder


@dataclass(frozen=True)
class Rendering:
    """What the network makes of a batch.

    Attributes:
        log_radiance: [B, V, 3, H, W] log10(1 + radiance), float32.
        transport_states: see Transported.states.
    """

    log_radiance: Float[Tensor, "b v 3 h w"]
    transport_states: tuple[Float[Tensor, "n width"], ...]


class RenderFormerPP(nn.Module):
    """Triangles → tokens → light transport → views.

    Every variant of the paper is this class with other parts; nothing here asks which.
    """

    def __init__(
        self,
        embedding: TriangleEmbedding,
        tokenizer: ObjectTokens | TriangleTokens,
        transport: PhysicsInformedTransport | UnconstrainedTransport,
        decoder: ViewDecoder,
    ):
        super().__init__()
        self.embedding = embedding
        self.tokenizer = tokenizer
        self.transport = transport
        self.decoder = decoder

    def forward(self, batch: RaggedBatch) -> Rendering:
        scene = self.encode(batch)
        return Rendering(self.decoder(scene.tokens, batch.c2w, batch.fov, batch.gbuffer), scene.states)

    def encode(self, batch: RaggedBatch) -> Transported:
        """The view-independent stage: once per scene, whatever the number of views."""
        triangles = self.embedding(batch)
        tokens = self.tokenizer(triangles, batch)
        return self.transport(tokens)

    @property
    def gbuffer_channels(self) -> tuple[str, ...]:
        """The G-buffer channels a batch must carry, in order."""
        return self.decoder.gbuffer_channels

    @property
    def patch_size(self) -> int:
        """Both sides of an image must be divisible by this."""
        return self.decoder.rays.patch_size
