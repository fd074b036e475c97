"""Where known light comes from: how it changes with the albedos of the surfaces that its rays have met.

Known light is linear in these albedos, but for the multiple scattering of glossy lobes, whose derivative is known. So a
record of rays is enough to tell how light would change, with all rays as they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


class Trace(NamedTuple):
    """Derivatives of the light at R places, color by color.

    Attributes:
        triangle: [R, S] that S rays of each place have met; 0, with derivatives of 0, where they have met none.
        diffuse, specular: [R, S, 3] by the albedos there.
        growth: [R, 3] of the logarithm of glossy light by the place's own specular albedo, which colors multiple
            scattering.
    """

    triangle: Int[np.ndarray, "r s"]
    diffuse: Float[np.ndarray, "r s 3"]
    specular: Float[np.ndarray, "r s 3"]
    growth: Float[np.ndarray, "r 3"]

    @classmethod
    def of(cls, places: int, rays: int) -> Trace:
        """To be filled in; nothing is recorded where there are no rays."""
        each = np.zeros((places, rays, 3), np.float32)
        growth = np.zeros((places if rays else 0, 3), np.float32)
        return cls(np.zeros((places, rays), np.int32), each, np.zeros_like(each), growth)
