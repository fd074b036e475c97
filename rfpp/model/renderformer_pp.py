"""RenderFormer++: the stages in the order of the paper's pipeline figure."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.imaging.radiance import log_decode, log_encode
from rfpp.model.exposure import MeanIrradianceExposure, UnitExposure
from rfpp.model.hoct import ObjectTokens
from rfpp.model.layers.scene_tokens import SceneTokens
from rfpp.model.pitg import IteratedTransport, Transport, TransportStates
from rfpp.model.renderformer.texture_patches import TexturePatchEmbedding
from rfpp.model.renderformer.triangle_tokens import TriangleTokens
from rfpp.model.triangle_embedding import TriangleEmbedding
from rfpp.model.view_decoder import ViewDecoder
from rfpp.segments import Segments


class RenderFormerPP(nn.Module):
    """Triangles → object tokens → light transport → views.

    RenderFormer and every row of the paper's tables are this class with other parts, named in `conf/model`.

    Args:
        embedding: Triangles to triangle tokens.
        tokenizer: Triangle tokens to scene tokens: HOCT, or RenderFormer's one token per triangle.
        transport: Light transport between scene tokens: PITG, or RenderFormer's self-attention.
        decoder: Scene tokens and ray bundles to images.
        exposure: Radiance at which each scene is normalized; 1 in the paper.
    """

    def __init__(
        self,
        embedding: TriangleEmbedding | TexturePatchEmbedding,
        tokenizer: ObjectTokens | TriangleTokens,
        transport: Transport,
        decoder: ViewDecoder,
        exposure: UnitExposure | MeanIrradianceExposure,
    ):
        super().__init__()
        self.embedding = embedding
        self.tokenizer = tokenizer
        self.transport = transport
        self.decoder = decoder
        self.exposure = exposure

    def forward(self, batch: RaggedBatch) -> Rendering:
        exposure = self.exposure(batch)
        return self.rendered(batch.normalized(exposure), exposure)

    def rendered(self, batch: RaggedBatch, exposure: Float[Tensor, " b"]) -> Rendering:
        """Render scenes that are already normalized to their exposure; reads nothing from the host."""
        scenes = self.transported(exposure, self.tokens(batch))
        log_radiance = self.view(scenes, batch.c2w, batch.fov, batch.gbuffer)
        return Rendering(log_radiance, scenes.transport_states, scenes.tokens.segments)

    def encode(self, batch: RaggedBatch) -> EncodedScenes:
        """Run the view-independent stage, once per scene for any number of views."""
        return self.transported(*self.tokenize(batch))

    def tokenize(self, batch: RaggedBatch) -> tuple[Float[Tensor, " b"], SceneTokens]:
        """Return each scene's exposure and its tokens at that exposure, before transport."""
        exposure = self.exposure(batch)
        return exposure, self.tokens(batch.normalized(exposure))

    def tokens(self, batch: RaggedBatch) -> SceneTokens:
        """Return the tokens of scenes that are already normalized to their exposure."""
        tokens: SceneTokens = self.tokenizer(self.embedding(batch), batch)
        return tokens

    def transported(self, exposure: Float[Tensor, " b"], tokens: SceneTokens) -> EncodedScenes:
        """Move light between the tokens that `tokenize` returned."""
        transported = self.transport(tokens)
        return EncodedScenes(transported.tokens, exposure, transported.states)

    def transported_each(
        self, exposure: Float[Tensor, " b"], tokens: SceneTokens, count: int
    ) -> tuple[list[EncodedScenes], TransportStates]:
        """Return the scenes after k = 0 … `count` applications of the operator, and the operator's states.

        Raises:
            ValueError: If the network has no operator (`iterations` is 0).
        """
        if not isinstance(self.transport, IteratedTransport):
            raise ValueError("this network has no transport operator to apply")
        after, states = self.transport.each(tokens, count)
        return [EncodedScenes(tokens, exposure, ()) for tokens in after], states

    def view(
        self,
        scenes: EncodedScenes,
        c2w: Float[Tensor, "b v 4 4"],
        fov: Float[Tensor, "b v"],
        gbuffer: Float[Tensor, "b v c h w"],
    ) -> Float[Tensor, "b v 3 h w"]:
        """Run the view-dependent stage: return log10(1 + radiance) of V views of each scene, float32.

        Args:
            fov: Full angle in degrees along the longer image side.
        """
        exposure = scenes.exposure[: len(c2w)]  # a padded batch has one more, see `RaggedBatch.padded`
        log_radiance = self.decoder(scenes.tokens, c2w, fov, gbuffer, exposure)
        return log_encode(exposure[:, None, None, None, None] * log_decode(log_radiance))

    @property
    def iterations(self) -> int:
        """K, the applications of the transport operator; 0 if there is none."""
        return self.transport.iterations

    @property
    def gbuffer_channels(self) -> tuple[str, ...]:
        """G-buffer channels that a batch must carry, in order."""
        return self.decoder.gbuffer_channels

    @property
    def patch_size(self) -> int:
        """Divisor of both image sides."""
        return self.decoder.rays.patch_size


@dataclass(frozen=True)
class EncodedScenes:
    """View-independent representation of B scenes.

    Attributes:
        tokens: Scene tokens with global illumination in their features.
        exposure: [B] radiance that the tokens call 1.
        transport_states: See `rfpp.model.pitg.Transported.states`.
    """

    tokens: SceneTokens
    exposure: Float[Tensor, " b"]
    transport_states: tuple[Float[Tensor, "n width"], ...]


@dataclass(frozen=True)
class Rendering:
    """Images of a batch.

    Attributes:
        log_radiance: [B, V, 3, H, W] log10(1 + radiance), float32.
        transport_states: See `rfpp.model.pitg.Transported.states`.
        token_segments: B segments of the N scene tokens.
    """

    log_radiance: Float[Tensor, "b v 3 h w"]
    transport_states: tuple[Float[Tensor, "n width"], ...]
    token_segments: Segments
