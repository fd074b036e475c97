"""The first light that arrives at cells, from which linear transport starts."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from rfpp.model.couplings import Couplings
from rfpp.packed_cells import PackedCells


class CastIrradiance:
    """T L_e as it was computed by rays, shadows included."""

    def __call__(self, cells: PackedCells, couplings: Couplings) -> Float[Tensor, "c 3"]:
        """Irradiance / π.

        Args:
            couplings: A.
        """
        return cells.arriving


class CoupledIrradiance:
    """A L_e: lights are cells like all others, and no rays are cast for their light (the paper's setting)."""

    def __call__(self, cells: PackedCells, couplings: Couplings) -> Float[Tensor, "c 3"]:
        """As `CastIrradiance`."""
        return couplings.arriving(cells.emitted)
