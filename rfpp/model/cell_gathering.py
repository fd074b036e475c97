"""From the light of cells to the light that pixels gather: the last step of a transport that is linear in light."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from rfpp.gbuffer.first_hit import CELL_CHANNELS
from rfpp.model.joint_window import JointWindow
from rfpp.model.lit_cells import LitCells


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
        return (*CELL_CHANNELS, *self.window.channels)

    def __call__(self, gbuffer: Float[Tensor, "n c h w"], cells: LitCells) -> Float[Tensor, "n 6 h w"]:
        """Light that the diffuse and the glossy lobe gather, in N views, equally many of each scene.

        Args:
            gbuffer: `channels`.
            cells: lit. The glossy lobe gathers what is beyond their first bounce: that one is in `reflected_light`.
        """
        lobes, guides = rays_of_lobes(gbuffer, cells, self.window)
        gathered = [of_rays(light, rows).mean(1).permute(0, 3, 1, 2) for rows, light in lobes]
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
        return (*CELL_CHANNELS, *self.window.channels)

    def forward(
        self, maps: Float[Tensor, "n maps h w"], gbuffer: Float[Tensor, "n c h w"], cells: LitCells
    ) -> Float[Tensor, "n 6 h w"]:
        """See EvenGathering."""
        lobes, guides = rays_of_lobes(gbuffer, cells, self.window)
        keys = nn.functional.linear(cells.features.float(), self.keys.weight.float()).chunk(2, dim=-1)
        of_lobes = zip(maps.chunk(2, dim=1), lobes, keys, strict=True)
        gathered = [self._gathered(m, rows, key, light) for m, (rows, light), key in of_lobes]
        return self.window(torch.cat(gathered, dim=1), guides)

    def _gathered(
        self,
        maps: Float[Tensor, "n query h w"],
        rows: Int[Tensor, "n rays h w"],
        keys: Float[Tensor, "c rank"],
        light: Float[Tensor, "c 3"],
    ) -> Float[Tensor, "n 3 h w"]:
        query, bias = maps.split([self.rank, 1], dim=1)
        score = torch.einsum("nqhw,nrhwq->nrhw", query, of_rays(keys, rows)) / self.rank**0.5
        weight = torch.exp(self.bound * torch.tanh(score + bias)) / rows.shape[1]
        return torch.einsum("nrhw,nrhwc->nchw", weight, of_rays(light, rows))


Lobe = tuple[Int[Tensor, "n rays h w"], Float[Tensor, "c 3"]]


def rays_of_lobes(
    gbuffer: Float[Tensor, "n channels h w"], cells: LitCells, window: JointWindow
) -> tuple[list[Lobe], Float[Tensor, "n guides h w"]]:
    """Of the diffuse and the glossy lobe the cells that rays end in and the light there is for it; and guides.

    Args:
        gbuffer: the channels of cells and the window's.
    """
    rays = (gbuffer.shape[1] - window.size) // 2
    diffuse, glossy, guides = gbuffer.split([rays, rays, window.size], dim=1)
    return [(cells.rows(diffuse), cells.light), (cells.rows(glossy), cells.light - cells.start)], guides


def of_rays(
    of_cells: Float[Tensor, "c n"], rows: Int[Tensor, "n_views rays h w"]
) -> Float[Tensor, "n_views rays h w n"]:
    """What each ray brings of the cell that it meets; zeros where it meets none."""
    with_nothing = torch.cat([of_cells, of_cells.new_zeros(1, of_cells.shape[1])])
    return F.embedding(rows, with_nothing)  # as indexing, with a gradient that is five times as fast on a CPU
