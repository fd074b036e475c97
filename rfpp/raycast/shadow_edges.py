"""Find the pixels that need more samples of a light: those at edges of its shadows and in its highlights."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, UInt8

from rfpp.raycast.compiled import compiled
from rfpp.raycast.lit_scene import LitScene
from rfpp.raycast.pixel_loops import LOBE, SQUARES, VISIBLE, WHOLE
from rfpp.raycast.surface import Points
from rfpp.raycast.vectors import added, dot, mean, scaled, triple

#: Highlights of lobes up to this α take all samples if the light is near the mirrored direction: stopping earlier would
#: miss bright samples more often than dark ones. Others do if their standard error exceeds this share of the light.
_SHARP, _NOISY = 0.25, 0.02
#: Half width of a lobe, in α, at 1/300 of its maximum.
_WIDTHS = 4
#: Bits of a pixel: a sample of the light was blocked, or visible.
HIDDEN, CLEAR = 1, 2


@compiled
def find_edges(
    scene: LitScene,
    light: int,
    points: Points,
    sums: Float[np.ndarray, "r sums"],
    samples: int,
    height: int,
    width: int,
    reach: int,
    seen: UInt8[np.ndarray, " pixels"],
    column: UInt8[np.ndarray, " w"],
    lobe: Float[np.ndarray, "pixels 3"],
    edge: Bool[np.ndarray, " pixels"],
) -> None:
    """Fill in which pixels need more samples of a light: at edges of shadows, and in sharp or noisy highlights.

    At an edge, some samples within `reach` pixels are visible and some are blocked. The choice depends on this light
    alone, so that the light of several is the sum of theirs.

    Args:
        samples: Samples per point in the sums.
        seen, lobe: Scratch space, zeros.
        column: Scratch space for a row.
        edge: [H · W] bool, the result.
    """
    for row in range(len(points.pixel)):
        own, pixel = sums[row], points.pixel[row]
        if own[VISIBLE] < own[WHOLE]:
            seen[pixel] |= HIDDEN
        if own[VISIBLE] <= 0:
            continue
        seen[pixel] |= CLEAR
        shine = mean(points.specular[row])
        lobe[pixel, 0] += own[LOBE] * shine
        lobe[pixel, 1] += own[SQUARES] * shine * shine
        lobe[pixel, 2] += own[VISIBLE] / np.pi * mean(points.diffuse[row])
        if 0 <= points.alpha[row] <= _SHARP and _mirrored(scene, light, points, row):
            lobe[pixel, 1] = np.inf
    count = samples * points.of_pixel
    for y in range(height):
        column[:] = 0
        for j in range(max(y - reach, 0), min(y + reach + 1, height)):
            for x in range(width):
                column[x] |= seen[j * width + x]
        for x in range(width):
            found = 0
            for i in range(max(x - reach, 0), min(x + reach + 1, width)):
                found |= column[i]
            shine, square, diffuse = scaled(lobe[y * width + x], 1 / count)
            error = np.sqrt(max(square - shine * shine, 0.0) / count)
            edge[y * width + x] = found == CLEAR | HIDDEN or error > _NOISY * (shine + diffuse)


@compiled
def _mirrored(scene: LitScene, light: int, points: Points, row: int) -> bool:
    """Return whether a point's glossy lobe varies much over a light, being near the mirrored direction.

    A normal between the directions to the eye and to the light is tilted by half the angle between the mirrored
    direction and the light, or more.
    """
    normal, eye = triple(points.normal[row]), triple(points.eye[row])
    mirrored = added(scaled(normal, 2 * dot(normal, eye)), scaled(eye, -1.0))
    away = added(triple(scene.middle[light]), scaled(triple(points.point[row]), -1.0))
    distance = np.sqrt(dot(away, away))
    if distance <= scene.reach[light]:
        return True
    angle = np.arccos(min(max(dot(mirrored, away) / distance, -1.0), 1.0))
    wide = np.arcsin(scene.reach[light] / distance)
    near: bool = (angle - wide) / 2 < _WIDTHS * points.alpha[row] + wide
    return near
