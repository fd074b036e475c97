"""Texture patches, the materials of RenderFormer's H5 scenes: 13 channels on a square grid per triangle.

Diffuse 3, specular 3, roughness 1, normal 3, emitted radiance 3. The triangle is the upper left half of the square.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

TEXTURE_CHANNELS = 13
#: Normal channels of a triangle without a normal map.
FLAT_NORMAL = (0.5, 0.5, 1.0)
#: Channels of a patch that correspond to `SceneTriangles.material`.
MATERIAL_CHANNELS = np.array([0, 1, 2, 3, 4, 5, 6, 10, 11, 12])
NORMAL_CHANNELS = slice(7, 10)


def covered_cells(size: int) -> Bool[np.ndarray, "size size"]:
    """Return a mask of the cells of the triangle: row + column at most `size`, from 0. Other cells are zero."""
    index = np.arange(size)
    return index[:, None] + index <= size


def is_constant(texture: Float[np.ndarray, "m 13 p p"]) -> bool:
    """True if every triangle has one material and no normal map, so that ten numbers replace its patch."""
    covered = covered_cells(texture.shape[-1])
    values = texture[:, :, 0, 0]
    flat = np.array(FLAT_NORMAL, values.dtype)
    expected = np.where(covered, values[:, :, None, None], values.dtype.type(0))
    return bool((values[:, NORMAL_CHANNELS] == flat).all() and (texture == expected).all())


def mean_material(texture: Float[np.ndarray, "m 13 p p"]) -> Float[np.ndarray, "m 10"]:
    """Return rows of `SceneTriangles.material`: the mean over each triangle's cells, exact if they are constant."""
    if is_constant(texture):
        return texture[:, MATERIAL_CHANNELS, 0, 0].astype(np.float32)
    covered = covered_cells(texture.shape[-1])
    return texture[:, MATERIAL_CHANNELS][:, :, covered].astype(np.float32).mean(-1)
