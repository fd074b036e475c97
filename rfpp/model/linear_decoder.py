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
KNOWN = ("albedo", "specular", "direct_diffuse", "direct_glossy", "reflected_light")


def radiance_of(view: ViewChannels, gathered: Float[Tensor, "n 6 h w"]) -> Float[Tensor, "n 3 h w"]:
    """albedo · (known + gathered diffuse light) + specular · (known + gathered glossy light)."""
    albedo, specular, diffuse, glossy, reflected = view.linear(KNOWN).chunk(5, dim=1)
    more_diffuse, more_glossy = gathered.chunk(2, dim=1)
    return albedo * (diffuse + more_diffuse) + specular * (glossy + reflected + more_glossy)


class LinearViewDecoder(ViewDecoder):
    """As ViewDecoder, but it reads no light, and its maps say how much light a pixel gathers of which cells.

    Not in the paper. To the light that is known, gathered light is added, and nothing past the cells: the image is
    linear in the lights.

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
        return means(radiance_of(of_points, repeated(gathered, supersampling)), supersampling)

    @property
    def gbuffer_channels(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys([*super().gbuffer_channels, *KNOWN]))
