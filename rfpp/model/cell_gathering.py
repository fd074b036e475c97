"""From the light of cells to the light that pixels gather: the last step of a transport that is linear in light."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from rfpp.gbuffer.first_hit import CELL_CHANNELS
from rfpp.model.joint_window import JointWindow
from rfpp.model.lit_cells import LitCells


class CellGathering(nn.Module):
    """Each pixel gathers the light of the cells its rays end in, weighted by what decoder and cells say of each other.

    A weight is 1 / (number of rays) times exp(γ tanh(query · key + bias)): never negative, and bounded, as no part of
    the network can do without it. (It is not normalised over a pixel's few rays, which would tie it to their noise.)
    The noise of the rays is then spread over a window of alike pixels.

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
        self,
        maps: Float[Tensor, "n maps h w"],
        gbuffer: Float[Tensor, "n c h w"],
        cells: LitCells,
    ) -> Float[Tensor, "n 6 h w"]:
        """Light that both lobes gather, in N views, equally many of each scene.

        Args:
            gbuffer: `channels`.
            cells: lit. The glossy lobe gathers what is beyond their first bounce: that one is in `reflected_light`.
        """
        rays = (gbuffer.shape[1] - self.window.size) // 2
        diffuse, glossy, guides = gbuffer.split([rays, rays, self.window.size], dim=1)
        keys = nn.functional.linear(cells.features.float(), self.keys.weight.float()).chunk(2, dim=-1)
        light = (cells.light, cells.light - cells.start)
        of_lobes = zip(maps.chunk(2, dim=1), (diffuse, glossy), keys, light, strict=True)
        gathered = [self._gathered(m, cells.rows(ids), key, light) for m, ids, key, light in of_lobes]
        return self.window(torch.cat(gathered, dim=1), guides)

    def _gathered(
        self,
        maps: Float[Tensor, "n query h w"],
        rows: Int[Tensor, "n rays h w"],
        keys: Float[Tensor, "c rank"],
        light: Float[Tensor, "c 3"],
    ) -> Float[Tensor, "n 3 h w"]:
        query, bias = maps.split([self.rank, 1], dim=1)
        keys, light = (torch.cat([x, x.new_zeros(1, x.shape[1])]) for x in (keys, light))  # the last row: nowhere
        score = torch.einsum("nqhw,nrhwq->nrhw", query, keys[rows]) / self.rank**0.5
        weight = torch.exp(self.bound * torch.tanh(score + bias)) / rows.shape[1]
        return torch.einsum("nrhw,nrhwc->nchw", weight, light[rows])
