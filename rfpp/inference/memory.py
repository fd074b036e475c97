"""What an image takes in memory, said before it is taken."""

from __future__ import annotations

import math

import psutil

from rfpp.errors import UserError

#: Of each point that is shaded, beside the network: rays, what they see, maps of features. Measured with rfpp-tiny at
#: 2 × 2 points in each of 256² and 512² pixels: 1,220 and 1,130.
_BYTES_PER_POINT = 1200


def require_memory(height: int, width: int, points: int, bytes_per_point: int = _BYTES_PER_POINT) -> None:
    """Raises UserError, with the numbers, for an image that needs more than there is.

    Args:
        height, width: in pixels.
        points: along each side of a pixel.
        bytes_per_point: that it takes beside the network.
    """
    needed, free = height * width * points**2 * bytes_per_point, psutil.virtual_memory().available
    if needed <= free:
        return
    side = math.isqrt(free // (points**2 * bytes_per_point))
    raise UserError(
        f"resolution {width} x {height}: takes about {needed / 2**30:,.0f} GB of memory, {free / 2**30:,.0f} are free: "
        f"give less, {side // 64 * 64} x {side // 64 * 64} fits"
    )
