"""RenderFormer++: the stages in the order of the paper's pipeline figure."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor, nn

from rfpp.batch import RaggedBatch
from rfpp.imaging.radiance import log_encode
from rfpp.model.exposure import MeanIrradianceExposure, UnitExposure
from rfpp.model.initial_light import CellLight, EmittedLight, FirstBounce
from rfpp.model.lit_cells import LitCells
from rfpp.model.points import means
from rfpp.model.refinement import Refinement, Unrefined
from rfpp.model.tokenizer import ObjectTokens, SceneTokens, TriangleTokens
from rfpp.model.transport import IteratedTransport, Transport, TransportStates
from rfpp.model.triangle_embedding import TexturePatchEmbedding, TriangleEmbedding
from rfpp.model.view_channels import ViewChannels, channel_sizes
from rfpp.model.view_decoder import ViewDecoder
from rfpp.segments import Segments


@dataclass(frozen=True)
class Rendering:
    """What the network makes of a batch.

    Attributes:
        log_radiance: [B, V, 3, H, W] log10(1 + radiance), float32.
        transport_states: see Transported.states.
        token_segments: B segments of their N tokens.
        state_segments: B segments of the rows of transport_states.
        divergence: see Transported.divergence.
    """

    log_radiance: Float[Tensor, "b v 3 h w"]
    transport_states: tuple[Float[Tensor, "n width"], ...]
    token_segments: Segments | None = None
    state_segments: Segments | None = None
    divergence: Float[Tensor, ""] | None = None


@dataclass(frozen=True)
class EncodedScenes:
    """What the view-independent stage makes of B scenes.

    Attributes:
        tokens: the scene tokens with global illumination in their features.
        exposure: [B] radiance that the tokens call 1.
        transport_states, divergence: see Transported.
    """

    tokens: SceneTokens
    exposure: Float[Tensor, " b"]
    transport_states: tuple[Float[Tensor, "n width"], ...]
    divergence: Float[Tensor, ""] | None = None


class RenderFormerPP(nn.Module):
    """Triangles → tokens → light transport → views.

    Every variant of the paper is this class with other parts; nothing here asks which.

    Args:
        refinement: of finished images; None, as in the paper, leaves them as the decoder gives them.
    """

    def __init__(
        self,
        embedding: TriangleEmbedding | TexturePatchEmbedding,
        tokenizer: ObjectTokens | TriangleTokens,
        transport: Transport,
        decoder: ViewDecoder,
        exposure: UnitExposure | MeanIrradianceExposure,
        source: EmittedLight | FirstBounce | CellLight,
        refinement: Refinement | None = None,
    ):
        super().__init__()
        self.embedding = embedding
        self.tokenizer = tokenizer
        self.transport = transport
        self.decoder = decoder
        self.exposure = exposure
        self.source = source
        self.refinement = refinement or Unrefined()

    def forward(self, batch: RaggedBatch, supersampling: int = 1) -> Rendering:
        scenes = self.encode(batch)
        log_radiance = self.view(scenes, batch.c2w, batch.fov, batch.gbuffer, supersampling)
        tokens, cells = scenes.tokens, scenes.tokens.cells
        of_states = cells.cells.scenes if isinstance(cells, LitCells) else tokens.segments
        return Rendering(log_radiance, scenes.transport_states, tokens.segments, of_states, scenes.divergence)

    def encode(self, batch: RaggedBatch) -> EncodedScenes:
        """The view-independent stage: once per scene, whatever the number of views."""
        return self.transported(*self.tokenize(batch))

    def tokenize(self, batch: RaggedBatch) -> tuple[Float[Tensor, " b"], SceneTokens]:
        """Each scene's exposure and, at that, its tokens before any light has moved."""
        exposure = self.exposure(batch)
        batch = batch.dimmed(exposure)
        return exposure, self.source(self.tokens(batch), batch)

    def tokens(self, batch: RaggedBatch) -> SceneTokens:
        """What a scene at its exposure is made of, with what it emits; see `source`."""
        tokens: SceneTokens = self.tokenizer(self.embedding(batch), batch)
        return tokens

    def transported(self, exposure: Float[Tensor, " b"], tokens: SceneTokens) -> EncodedScenes:
        """What `tokenize` made, after light has moved."""
        transported = self.transport(tokens)
        return EncodedScenes(transported.tokens, exposure, transported.states, transported.divergence)

    def bounces(self, batch: RaggedBatch, count: int) -> tuple[list[Float[Tensor, "b v 3 h w"]], TransportStates]:
        """log10(1 + radiance) decoded after k = 0 … `count` applications of the operator, and what it was applied to.

        For a network with an operator, see `iterations`.
        """
        encoded, bounces = self.transported_each(*self.tokenize(batch), count)
        return [self.view(scenes, batch.c2w, batch.fov, batch.gbuffer) for scenes in encoded], bounces

    def transported_each(
        self, exposure: Float[Tensor, " b"], tokens: SceneTokens, count: int
    ) -> tuple[list[EncodedScenes], TransportStates]:
        """What `tokenize` made, after k = 0 … `count` applications; see `bounces`.

        Raises ValueError if the network has no operator.
        """
        if not isinstance(self.transport, IteratedTransport):
            raise ValueError("this network has no transport operator that could be applied again")
        after, bounces = self.transport.each(tokens, count)
        return [EncodedScenes(tokens, exposure, ()) for tokens in after], bounces

    def view(
        self,
        scenes: EncodedScenes,
        c2w: Float[Tensor, "b v 4 4"],
        fov: Float[Tensor, "b v"],
        gbuffer: Float[Tensor, "b v c h w"],
        supersampling: int = 1,
        stride: int = 1,
        refined: bool = True,
    ) -> Float[Tensor, "b v 3 height width"]:
        """The view-dependent stage: log10(1 + radiance) of V views of each scene, float32.

        Args:
            gbuffer: `gbuffer_channels`.
            supersampling, stride: see `ViewDecoder.forward`.
            refined: whether the image passes through the refinement, if there is one.
        """
        sizes = channel_sizes(self.gbuffer_channels, gbuffer.shape[2])
        to_decoder = gbuffer[:, :, : sum(sizes[: len(self.decoder.gbuffer_channels)])]
        radiance = self.decoder(scenes.tokens, c2w, fov, to_decoder, scenes.exposure, supersampling, stride)
        if refined:
            surfaces = self._surfaces(gbuffer.flatten(0, 1), supersampling)
            radiance = self.refinement(radiance.flatten(0, 1), surfaces, fov.flatten()).view_as(radiance)
        return log_encode(scenes.exposure[:, None, None, None, None] * radiance)

    def _surfaces(self, gbuffer: Float[Tensor, "n c h w"], supersampling: int) -> Float[Tensor, "n _ height width"]:
        """What the refinement reads of N views' G-buffers (`gbuffer_channels`): means over pixels."""
        no_light = gbuffer.new_ones(len(gbuffer))
        of_points = ViewChannels(gbuffer, self.gbuffer_channels, no_light)
        return means(of_points.linear(self.refinement.channels), supersampling)

    @property
    def iterations(self) -> int:
        """K, how often the transport operator is applied; 0 where there is none."""
        return self.transport.iterations

    @property
    def reads(self) -> tuple[str, ...]:
        """What batches must carry besides triangles and G-buffers: names of `RaggedBatch`."""
        return tuple({**dict.fromkeys(self.source.reads), **dict.fromkeys(self.tokenizer.reads)})

    @property
    def linear_in_lights(self) -> bool:
        """Whether the image of several lights is the sum of theirs, before refinement."""
        return self.decoder.linear_in_lights

    @property
    def gbuffer_channels(self) -> tuple[str, ...]:
        """The G-buffer channels a batch must carry, in order."""
        return tuple(dict.fromkeys([*self.decoder.gbuffer_channels, *self.refinement.channels]))

    @property
    def shades_points(self) -> bool:
        """Whether reflectances of the G-buffer are in the image to the point, so that supersampling has a use."""
        return bool(self.decoder.shading.channels)

    @property
    def sees_coarse_pixels(self) -> bool:
        """Whether what its head says of coarse pixels can be carried to finer ones (`stride`)."""
        return self.shades_points and set(self.decoder.upsampling.channels) <= set(self.gbuffer_channels)

    @property
    def patch_size(self) -> int:
        """Both sides of an image must be divisible by this."""
        return self.decoder.rays.patch_size
