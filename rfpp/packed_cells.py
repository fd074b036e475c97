"""The cells of many scenes, packed end to end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from rfpp.gbuffer.cells import Cells, parts
from rfpp.segments import Segments, on_device

#: What of cells is light.
LIGHT = ("emitted", "arriving", "highlights")


@dataclass(frozen=True)
class PackedCells:
    """C cells of B scenes; see `rfpp.gbuffer.cells.Cells`.

    Attributes:
        octant: [C] int64, 8 · object of the batch + octant.
        centre, normal, diffuse, specular, emitted, arriving, highlights: [C, 3].
        area, roughness: [C].
        hits, onward: [C, R] int64, cells of the same scene, counted from its first; -1 for none.
        scenes: B segments of the cells.
    """

    octant: Int[Tensor, " c"]
    centre: Float[Tensor, "c 3"]
    normal: Float[Tensor, "c 3"]
    area: Float[Tensor, " c"]
    diffuse: Float[Tensor, "c 3"]
    specular: Float[Tensor, "c 3"]
    roughness: Float[Tensor, " c"]
    emitted: Float[Tensor, "c 3"]
    arriving: Float[Tensor, "c 3"]
    highlights: Float[Tensor, "c 3"]
    hits: Int[Tensor, "c rays"]
    onward: Int[Tensor, "c rays"]
    scenes: Segments

    @classmethod
    def pack(cls, cells: Sequence[Cells], objects: Sequence[int]) -> PackedCells:
        """Of scenes with so many objects."""
        columns = [parts(of_scene) for of_scene in cells]
        packed = {name: torch.from_numpy(np.concatenate([column[name] for column in columns])) for name in columns[0]}
        before = np.repeat(np.cumsum(objects) - objects, [len(of_scene) for of_scene in cells])
        packed["octant"] = packed["octant"].long() + 8 * torch.from_numpy(before)
        packed |= {name: packed[name].long() for name in ("hits", "onward")}
        return cls(**packed, scenes=Segments.from_lengths([len(of_scene) for of_scene in cells]))

    def __len__(self) -> int:
        return len(self.area)

    def octant_centres(self, objects: int) -> Float[Tensor, "octants 3"]:
        """[8 · objects, 3] means of the cells' centres by their area; of the whole object where an octant has none."""
        weight = self.area.clamp_min(1e-12)[:, None]
        weighted = torch.cat([self.centre * weight, weight], dim=-1)
        sums = weighted.new_zeros(8 * objects, 4).index_add(0, self.octant, weighted).view(objects, 8, 4)
        whole = sums.sum(1, keepdim=True).expand(-1, 8, -1)
        sums = torch.where(sums[..., 3:] > 0, sums, whole).flatten(0, 1)
        return sums[:, :3] / sums[:, 3:].clamp_min(1e-12)

    def dimmed(self, factor: Float[Tensor, " b"]) -> PackedCells:
        """Every scene's light divided by its factor."""
        per_cell = factor[self.scenes.index][:, None]
        return replace(self, **{name: getattr(self, name) / per_cell for name in LIGHT})

    @cached_property
    def _rows(self) -> tuple[Int[Tensor, "b longest"], Bool[Tensor, "b longest"], Int[Tensor, " c"]]:
        """Which cell stands at each place of [B, longest], whether one does, and where each cell stands."""
        lengths = np.array(self.scenes.lengths)
        places = np.arange(max(1, lengths.max(initial=0)))
        real = places < lengths[:, None]
        rows = np.where(real, (np.cumsum(lengths) - lengths)[:, None] + places, 0)
        return tuple(on_device(table, self.area.device) for table in (rows, real, np.flatnonzero(real)))

    def padded(self, values: Shaped[Tensor, c * features]) -> Shaped[Tensor, "b longest *features"]:
        """Scene by scene, zeros where a scene has no more cells."""
        rows, real, _ = self._rows
        if not len(self):
            return values.new_zeros(*rows.shape, *values.shape[1:])
        return values[rows] * real.view(*real.shape, *(1,) * (values.ndim - 1)).to(values.dtype)

    def packed(self, values: Shaped[Tensor, "b longest *features"]) -> Shaped[Tensor, c * features]:
        """The inverse of `padded`."""
        return values.flatten(0, 1)[self._rows[2]]

    def rows(self, seen: Int[Tensor, "c rays"]) -> Int[Tensor, "c rays"]:
        """Cells that cells see, from numbers within the scene to rows; C for none."""
        first = self.scenes.offsets[:-1].long()[self.scenes.index][:, None]
        return torch.where(seen < 0, len(self), seen + first)

    def to(self, device: torch.device | str, **kwargs) -> PackedCells:
        return PackedCells(**{field.name: getattr(self, field.name).to(device, **kwargs) for field in fields(self)})

    def pin_memory(self) -> PackedCells:
        return PackedCells(**{field.name: getattr(self, field.name).pin_memory() for field in fields(self)})
