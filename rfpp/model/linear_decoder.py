"""The view-dependent stage of networks whose light comes from cells."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.gbuffer.first_hit import GATHERED_CHANNELS
from rfpp.model.autocast import in_float32
from rfpp.model.cell_gathering import CellGathering, EvenGathering
from rfpp.model.points import means, repeated
from rfpp.model.tokenizer import SceneTokens
from rfpp.model.view_channels import ViewChannels
from rfpp.model.view_decoder import ViewDecoder

#: What is known of a pixel: reflectances, its first bounce, and that of what it reflects.
KNOWN = ("albedo", "specular", "direct_diffuse", "direct_glossy", "reflected_light")


def radiance_of(
    view: ViewChannels,
    gathered: Float[Tensor, "n 6 h w"],
    factors: Float[Tensor, "n 6 h w"] | float = 1.0,
    of_reflected: Float[Tensor, "n 1 h w"] | float = 1.0,
) -> Float[Tensor, "n 3 h w"]:
    """albedo · (known + gathered diffuse light) + specular · (known + gathered glossy light).

    Args:
        factors: of the known light.
        of_reflected: the share of `reflected_light` that is not in the gathered light.
    """
    albedo, specular, diffuse, glossy, reflected = view.linear(KNOWN).chunk(5, dim=1)
    known = torch.cat([diffuse, glossy + of_reflected * reflected], dim=1)
    diffuse, glossy = (factors * known + gathered).chunk(2, dim=1)
    return albedo * diffuse + specular * glossy


def radiance_with(
    gather: Callable[[Float[Tensor, "n 3 h w"]], Float[Tensor, "n 6 h w"]], of_points: ViewChannels, supersampling: int
) -> Float[Tensor, "n 3 height width"]:
    """Radiance of pixels that share what dull surfaces reflect with their neighbours, as they do gathered light.

    A few rays of a broad lobe are grain, those of a window of pixels are not; a mirror's image has to stay sharp. So
    the share of `reflected_light` that is shared is the roughness.

    Args:
        gather: from glossy light of pixels, to be shared, to gathered light with it.
        of_points: with so many points along each side of a pixel.
    """
    roughness, reflected = of_points.linear(("roughness", "reflected_light")).split([1, 3], dim=1)
    gathered = repeated(gather(means(roughness * reflected, supersampling)), supersampling)
    return means(radiance_of(of_points, gathered, of_reflected=1 - roughness), supersampling)


class LinearViewDecoder(ViewDecoder):
    """As ViewDecoder, but it reads no light, and its maps say how much light a pixel gathers of which cells.

    Not in the paper. To the light that is known, gathered light is added, and nothing past the cells: the image is
    linear in the lights.

    Args:
        shading: from maps and cells to gathered light.
        others: see ViewDecoder; its `gbuffer_channels` hold no light.
    """

    linear_in_lights = True

    def __init__(self, *, shading: CellGathering, **others: Any):
        super().__init__(**others, shading=shading)
        self.head.start_at(0.0)

    def _shaded(
        self,
        maps: Float[Tensor, "n maps h w"],
        scene: SceneTokens,
        of_pixels: ViewChannels,
        of_points: ViewChannels,
        supersampling: int,
    ) -> Float[Tensor, "n 3 h w"]:
        def gather(shared: Float[Tensor, "n 3 h w"]) -> Float[Tensor, "n 6 h w"]:
            with in_float32(maps):
                return self.shading(maps, of_pixels.linear(self.shading.channels), scene.lit_cells, shared)

        return radiance_with(gather, of_points, supersampling)

    @property
    def gbuffer_channels(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys([*super().gbuffer_channels, *KNOWN]))


class CorrectedViewDecoder(ViewDecoder):
    """As ViewDecoder, but rays read the light that is known and gathered, and its maps are factors of it.

    Not in the paper. Four factors, exp(γ tanh(map)), of the known and the gathered light of both lobes, which carry the
    noise of their samples and what cells are too coarse for. Nothing is added: without light it stays black. The image
    is linear in the brightness of all lights (with `MeanIrradianceExposure`), no longer in each light.

    Args:
        gathering: from cells to pixels.
        shading: see `BoundedFactors`.
        others: see ViewDecoder; its `gbuffer_channels` may name GATHERED_CHANNELS.
    """

    def __init__(self, *, gathering: EvenGathering, shading: BoundedFactors, **others: Any):
        super().__init__(**others, shading=shading)
        self.gathering = gathering
        self.head.start_at(0.0)

    def _completed(self, of_pixels: ViewChannels, scene: SceneTokens) -> ViewChannels:
        with in_float32(of_pixels.gbuffer):
            gathered = self.gathering(of_pixels.linear(self.gathering.channels), scene.lit_cells)
        return of_pixels.with_gathered(gathered * of_pixels.exposure[:, None, None, None])

    def _shaded(
        self,
        maps: Float[Tensor, "n maps h w"],
        scene: SceneTokens,
        of_pixels: ViewChannels,
        of_points: ViewChannels,
        supersampling: int,
    ) -> Float[Tensor, "n 3 h w"]:
        of_known, of_gathered = self.shading(maps).chunk(2, dim=1)
        gathered = of_gathered.repeat_interleave(3, dim=1) * of_pixels.linear(GATHERED_CHANNELS)
        known = repeated(of_known.repeat_interleave(3, dim=1), supersampling)
        return means(radiance_of(of_points, repeated(gathered, supersampling), known), supersampling)

    @property
    def gbuffer_channels(self) -> tuple[str, ...]:
        read = [*super().gbuffer_channels, *self.gathering.channels, *KNOWN]
        return tuple(name for name in dict.fromkeys(read) if name not in GATHERED_CHANNELS)


class BoundedFactors:
    """exp(γ tanh(map)): of the known diffuse and glossy light, and of the gathered.

    Args:
        bound: γ.
    """

    maps = 4
    channels: tuple[str, ...] = ()

    def __init__(self, bound: float):
        self.bound = bound

    def __call__(self, maps: Float[Tensor, "n 4 h w"]) -> Float[Tensor, "n 4 h w"]:
        return torch.exp(self.bound * torch.tanh(maps))
