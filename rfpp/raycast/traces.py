"""Derivatives of reflections by the albedos of the surfaces that their rays hit.

Reflections are linear in these albedos, except for the multiple scattering of glossy lobes, whose derivative is known.
Recorded rays therefore suffice to differentiate them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Trace(NamedTuple):
    """Derivatives of the light at R points, for each color.

    Attributes:
        triangle: Triangles hit by S rays from each point; 0, with derivatives of 0, where there is no hit.
        diffuse, specular: Derivatives by their albedos.
        growth: Derivative of the logarithm of glossy light by the point's own specular albedo, which colors multiple
            scattering.
    """

    triangle: Int[np.ndarray, "r s"]
    diffuse: Float[np.ndarray, "r s 3"]
    specular: Float[np.ndarray, "r s 3"]
    growth: Float[np.ndarray, "r 3"]

    @classmethod
    def of(cls, places: int, rays: int) -> Trace:
        """Return an empty record to fill in; it records nothing if there are no rays."""
        each = np.zeros((places, rays, 3), np.float32)
        growth = np.zeros((places if rays else 0, 3), np.float32)
        return cls(np.zeros((places, rays), np.int32), each, np.zeros_like(each), growth)
