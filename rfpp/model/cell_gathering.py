"""From the light of cells to the light that pixels gather: the last step of a transport that is linear in light."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from rfpp.gbuffer.first_hit import BOUNCED_LIGHT, CELL_CHANNELS
from rfpp.model.couplings import of_rays
from rfpp.model.joint_window import JointWindow
from rfpp.model.lit_cells import LitCells
from rfpp.model.view_channels import channel_sizes

#: What is gathered of, beside the channels of a window.
GATHERING_CHANNELS = (*CELL_CHANNELS, BOUNCED_LIGHT)


class EvenGathering:
    """Each pixel gathers the light of the cells its rays end in, and shares it with alike pixels around it.

    A few rays of one pixel are noise; a window of pixels has enough of them.

    Args:
        window: of pixels.
    """

    def __init__(self, window: JointWindow):
        self.window = window

    @property
    def channels(self) -> tuple[str, ...]:
        """What it needs of the G-buffer, in order."""
        return (*GATHERING_CHANNELS, *self.window.channels)

    def __call__(
        self, gbuffer: Float[Tensor, "n c h w"], cells: LitCells, shared: Float[Tensor, "n 3 h w"] | float = 0.0
    ) -> Float[Tensor, "n 6 h w"]:
        """Light that the diffuse and the glossy lobe gather, in N views, equally many of each scene.

        Args:
            gbuffer: `channels`.
            cells: lit.
            shared: glossy light that pixels know, to be shared in the same way.
        """
        lobes, guides = lobes_of(gbuffer, cells, self.window)
        gathered = [lobe.light.mean(1).permute(0, 3, 1, 2) + lobe.known for lobe in lobes]
        gathered[1] = gathered[1] + shared
        return self.window(torch.cat(gathered, dim=1), guides)


class CellGathering(nn.Module):
    """As EvenGathering, weighted by what decoder and cells say of each other.

    A weight is 1 / (number of rays) times exp(γ tanh(query · key + bias)): never negative, and bounded, as no part of
    the network can do without it. (It is not normalised over a pixel's few rays, which would tie it to their noise.)

    Args:
        width: of the cells' features.
        rank: of queries and keys.
        bound: γ.
        window: of pixels.
    """

    def __init__(self, width: int, rank: int, bound: float, window: JointWindow):
        super().__init__()
        self.keys = nn.Linear(width, 2 * rank, bias=False)
        nn.init.zeros_(self.keys.weight)  # starts as the rays say
        self.rank, self.bound, self.window = rank, bound, window

    @property
    def maps(self) -> int:
        """What a pixel's query is made of: for each lobe `rank` numbers and a bias."""
        return 2 * (self.rank + 1)

    @property
    def channels(self) -> tuple[str, ...]:
        """What it needs of the G-buffer, in order."""
        return (*GATHERING_CHANNELS, *self.window.channels)

    def forward(
        self,
        maps: Float[Tensor, "n maps h w"],
        gbuffer: Float[Tensor, "n c h w"],
        cells: LitCells,
        shared: Float[Tensor, "n 3 h w"] | float = 0.0,
    ) -> Float[Tensor, "n 6 h w"]:
        """See EvenGathering."""
        lobes, guides = lobes_of(gbuffer, cells, self.window)
        keys = nn.functional.linear(cells.features.float(), self.keys.weight.float()).chunk(2, dim=-1)
        of_lobes = zip(maps.chunk(2, dim=1), lobes, keys, strict=True)
        gathered = [self._gathered(m, key, lobe) + lobe.known for m, lobe, key in of_lobes]
        gathered[1] = gathered[1] + shared
        return self.window(torch.cat(gathered, dim=1), guides)

    def _gathered(
        self, maps: Float[Tensor, "n query h w"], keys: Float[Tensor, "c rank"], lobe: Lobe
    ) -> Float[Tensor, "n 3 h w"]:
        query, bias = maps.split([self.rank, 1], dim=1)
        score = torch.einsum("nqhw,nrhwq->nrhw", query, of_rays(keys, lobe.seen)) / self.rank**0.5
        weight = torch.exp(self.bound * torch.tanh(score + bias)) / score.shape[1]
        return torch.einsum("nrhw,nrhwc->nchw", weight, lobe.light)


@dataclass(frozen=True)
class Lobe:
    """What one lobe of N views' pixels sees.

    Attributes:
        seen: rows of the cells that rays end in; C for none.
        light: [N, S, H, W, 3] radiance that each ray brings, of light that has bounced before.
        known: [N, 3, H, W] that all of them bring of the emitters' light, where they end.
    """

    seen: Int[Tensor, "n rays h w"]
    light: Float[Tensor, "n rays h w 3"]
    known: Float[Tensor, "n 3 h w"]


def lobes_of(
    gbuffer: Float[Tensor, "n channels h w"], cells: LitCells, window: JointWindow
) -> tuple[tuple[Lobe, Lobe], Float[Tensor, "n guides h w"]]:
    """The diffuse and the glossy lobe, and guides of the window.

    The emitters' light is known where rays end, better than as the mean over a cell: of the diffuse lobe it is
    `bounced_light`, of the glossy lobe it is in `reflected_light`.

    Args:
        gbuffer: `GATHERING_CHANNELS` and the window's.
    """
    sizes = channel_sizes((*GATHERING_CHANNELS, *window.channels), gbuffer.shape[1])
    of_cells = len(CELL_CHANNELS)
    *rays, bounced, guides = gbuffer.split([*sizes[: of_cells + 1], window.size], dim=1)
    diffuse, glossy, diffuse_onward, glossy_onward = (cells.rows(seen) for seen in rays)
    further = cells.beyond_first()
    return (
        Lobe(diffuse, _brought(further, diffuse, diffuse_onward), bounced),
        Lobe(glossy, _brought(further, glossy, glossy_onward), torch.zeros_like(bounced)),
    ), guides


def _brought(
    cells: LitCells, seen: Int[Tensor, "n rays h w"], onward: Int[Tensor, "n rays h w"]
) -> Float[Tensor, "n rays h w 3"]:
    """Diffuse light of the cells that rays end in, and what their glossy lobes send back of others."""
    reflectance = cells.reflectance
    mirrored = of_rays(reflectance.specular, seen) * of_rays(reflectance.dull * cells.before, onward)
    return of_rays(reflectance.diffuse * cells.arriving, seen) + mirrored
