"""The channels of a batch of views by their names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.gbuffer.first_hit import CELL_CHANNELS, CHANNELS, GATHERED_CHANNELS, LIGHT_CHANNELS
from rfpp.imaging.radiance import log_encode
from rfpp.model.points import means

#: Numbers of every channel that decoders know, light among them.
SIZES = CHANNELS | dict.fromkeys(GATHERED_CHANNELS, 3)
_LIGHT = (*LIGHT_CHANNELS, *GATHERED_CHANNELS)


def channel_sizes(names: Sequence[str], count: int) -> list[int]:
    """How many of so many stacked numbers each channel has: channels of cells one for each ray that was cast.

    Raises ValueError if these channels cannot have so many.
    """
    of_cells = sum(name in CELL_CHANNELS for name in names)
    others = sum(SIZES[name] for name in names if name not in CELL_CHANNELS)
    rays = (count - others) // of_cells if of_cells else 0
    if count != others + of_cells * rays or (of_cells and rays < 1):
        raise ValueError(f"{count} G-buffer channels where {tuple(names)} were expected")
    return [rays if name in CELL_CHANNELS else SIZES[name] for name in names]


@dataclass(frozen=True)
class ViewChannels:
    """G-buffers of N views.

    Attributes:
        gbuffer: the channels `names` stacked.
        exposure: [N] radiance that the network calls 1.
    """

    gbuffer: Float[Tensor, "n c h w"]
    names: Sequence[str]
    exposure: Float[Tensor, " n"]

    def __post_init__(self) -> None:
        """Raises ValueError when there are other channels than named."""
        channel_sizes(self.names, self.gbuffer.shape[1])

    def __call__(self, names: Sequence[str]) -> Float[Tensor, "n c h w"]:
        """Some of the channels, light as log10(1 + light / exposure)."""
        unit = self.exposure[:, None, None, None]
        return self._stacked([log_encode(x / unit) if n in _LIGHT else x for n, x in self._each(names)])

    def linear(self, names: Sequence[str]) -> Float[Tensor, "n c h w"]:
        """Some of the channels, light in units of the exposure."""
        unit = self.exposure[:, None, None, None]
        return self._stacked([x / unit if n in _LIGHT else x for n, x in self._each(names)])

    def pooled(self, points: int) -> ViewChannels:
        """Pixels of so many points along each side: means, and of cells, which all points know, those of one."""
        if points == 1:
            return self
        if not self.names:
            return replace(self, gbuffer=self.gbuffer[..., ::points, ::points])
        pooled = [
            x[..., ::points, ::points] if n in CELL_CHANNELS else means(x, points) for n, x in self._each(self.names)
        ]
        return replace(self, gbuffer=torch.cat(pooled, dim=1))

    def with_gathered(self, light: Float[Tensor, "n 6 h w"]) -> ViewChannels:
        """The same and GATHERED_CHANNELS, linear."""
        return replace(self, gbuffer=torch.cat([self.gbuffer, light], dim=1), names=(*self.names, *GATHERED_CHANNELS))

    def _each(self, names: Sequence[str]) -> list[tuple[str, Float[Tensor, "n _ h w"]]]:
        parts = self.gbuffer.split(channel_sizes(self.names, self.gbuffer.shape[1]), dim=1)
        named = dict(zip(self.names, parts, strict=True))
        return [(name, named[name]) for name in names]

    def _stacked(self, parts: Sequence[Tensor]) -> Float[Tensor, "n c h w"]:
        return torch.cat([self.gbuffer[:, :0], *parts], dim=1)
