"""The interface between the renderer and the two systems it renders with."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np
from jaxtyping import Float
from torch import nn

from rfpp.inference.plan import Plan

Image = Float[np.ndarray, "h w 3"]


class Engine(Protocol):
    """A rendering system: `NetworkEngine` (RenderFormer++ and RenderFormer) or `RadiosityEngine`.

    Attributes:
        iterations: Usual number of transport iterations; 0 if there are none.
        is_linear: Whether the unrefined image is a sum over lights and bounces.
        supersamples: Whether several samples per pixel make a difference.
    """

    module: nn.Module
    patch_size: int
    iterations: int
    is_linear: bool
    supersamples: bool

    def views(self, plan: Plan, light: str | None = None, is_refined: bool = True) -> Iterator[Image]:
        """Yield the linear radiance of each camera, as soon as it is finished.

        Args:
            light: Object whose light alone counts; None for all lights. Only if `is_linear`.
            is_refined: Whether finished images pass through the refinement, if there is one.
        """
        ...
