"""PLY: each connected component becomes a part, smooth where it is flatter than a crease.

Colours of faces or vertices are the diffuse albedo; 8-bit ones are sRGB. Everything else is that of a dull dielectric.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError
from rfpp.scene.io.grouping import components
from rfpp.scene.io.image_texture import linear
from rfpp.scene.io.imported_scene import DIELECTRIC, ImportedScene, Part, fans, plain_material
from rfpp.scene.io.limits import read_bytes, require_bounded
from rfpp.scene.io.ply_file import Column, columns_of
from rfpp.scene.triangles import DIFFUSE

_INDICES = ("vertex_indices", "vertex_index")
_COLOURS = ("red", "green", "blue")


def read_ply(path: Path) -> ImportedScene:
    """Raises SceneError, without the file's name."""
    columns = columns_of(read_bytes(path))
    vertices, faces = columns.get("vertex", {}), columns.get("face", {})
    indices = next((faces[name] for name in _INDICES if isinstance(faces.get(name), tuple)), None)
    if indices is None or not set("xyz") <= vertices.keys():
        raise SceneError("holds no faces, and points cannot be rendered: make a mesh of it")
    sizes, corners = indices
    require_bounded(int(np.maximum(sizes - 2, 0).sum()))
    places, polygon = fans(sizes)
    triangles = corners.astype(np.int64)[places]
    positions = np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], axis=1)
    part = Part(path.stem, positions, triangles, plain_material(len(triangles)), smooth=True)
    if not len(part):
        raise SceneError("holds no faces: export it again")
    if set(_COLOURS) <= faces.keys():
        part.material[:, DIFFUSE] = (1 - DIELECTRIC) * _colours(faces)[polygon]
    elif set(_COLOURS) <= vertices.keys():
        part.material[:, DIFFUSE] = (1 - DIELECTRIC) * _colours(vertices)[triangles].mean(axis=1)
    return ImportedScene(path.stem, tuple(components(part)))


def _colours(columns: dict[str, Column]) -> Float[np.ndarray, "n 3"]:
    """Linear in [0, 1]."""
    channels = [columns[name] for name in _COLOURS]
    if all(channel.dtype == np.uint8 for channel in channels):
        return linear(np.stack(channels, axis=1))
    values = np.stack(channels, axis=1).astype(np.float32)
    if not np.isfinite(values).all():
        raise SceneError("a colour is NaN or infinite: export it again")
    return np.clip(values, 0, 1)
