"""The view-dependent stage of a network that is linear in light."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn

from rfpp.model.cell_gathering import CellGathering
from rfpp.model.precision import in_float32
from rfpp.model.tokenizer import SceneTokens
from rfpp.model.view_channels import ViewChannels
from rfpp.model.view_decoder import ViewDecoder, means, repeated

#: What is known of a pixel: reflectances, its first bounce, and that of what it reflects.
_KNOWN = ("albedo", "specular", "direct_diffuse", "direct_glossy", "reflected_light")


class LinearViewDecoder(ViewDecoder):
    """As ViewDecoder, but it reads no light, and its maps say how much light a pixel gathers of which cells.

    Not in the paper. Radiance is albedo · (known + gathered diffuse light) + specular · (known + gathered glossy
    light); nothing is added past the cells, so the image is linear in the lights.

    Args:
        shading: from maps and cells to gathered light.
        others: see ViewDecoder; its `gbuffer_channels` hold no light.
    """

    def __init__(self, *, shading: CellGathering, **others):
        super().__init__(**others, shading=shading)
        nn.init.zeros_(self.head.out[-1].bias)

    def _shaded(
        self,
        maps: Float[Tensor, "n maps h w"],
        scene: SceneTokens,
        of_pixels: ViewChannels,
        of_points: ViewChannels,
        supersampling: int,
    ) -> Float[Tensor, "n 3 h w"]:
        with in_float32(maps):
            gathered = self.shading(maps, of_pixels.linear(self.shading.channels), scene.cells)
        more_diffuse, more_glossy = repeated(gathered, supersampling).chunk(2, dim=1)
        albedo, specular, diffuse, glossy, reflected = of_points.linear(_KNOWN).chunk(5, dim=1)
        radiance = albedo * (diffuse + more_diffuse) + specular * (glossy + reflected + more_glossy)
        return means(radiance, supersampling)

    @property
    def gbuffer_channels(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys([*super().gbuffer_channels, *_KNOWN]))
