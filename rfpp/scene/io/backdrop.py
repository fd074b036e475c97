"""Something to stand on for what is brought without surroundings: a floor, or a floor and two walls.

A lone object floats in black, is lit from nowhere else and throws no shadow that could be seen.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from rfpp.scene.io.framing import bounds
from rfpp.scene.io.imported_scene import ImportedScene, Part, plain_material

Backdrop = Literal["floor", "corner", "none"]

#: Half the side of a panel, a little more than that of training scenes; squares along a side, as theirs.
_HALF, _SQUARES = 0.8, 8
#: Distance to what stands on the floor: no two surfaces in one plane.
_GAP = 0.002
#: What lies in this share of a scene's height, from the bottom, may be a floor.
_LOWEST = 0.05
_NAMES = {"floor": "a floor", "corner": "a floor and two walls"}


def stood(scene: ImportedScene, backdrop: Backdrop, path: Path) -> ImportedScene:
    """A framed scene with the backdrop that it lacks, grey and dull; with a warning that says so.

    A scene with a camera, a light or a floor of its own has surroundings, and stays as it is.
    """
    surrounded = scene.cameras or scene.lamps or any(part.is_light for part in scene.parts)
    if backdrop == "none" or surrounded or _has_floor(scene.parts):
        return scene
    low, high = bounds(scene.parts)
    x, y, _ = (low + high) / 2
    floor = np.array([x, y, low[2] - _GAP])
    right, back, up = np.eye(3)
    panels = [("floor", floor, right, back)]
    if backdrop == "corner":  # behind, for the camera that is added looks from the front, the right and above
        panels += [("back_wall", floor + _HALF * (back + up), right, up)]
        panels += [("left_wall", floor + _HALF * (up - right), up, back)]
    warnings.warn(
        f"{path}: it stands in nothing: {_NAMES[backdrop]} is added (backdrop=none leaves it out)", stacklevel=4
    )
    parts = [_panel(name, centre, u, v) for name, centre, u, v in panels]
    return ImportedScene(scene.name, (*scene.parts, *parts), scene.lamps, scene.cameras)


def _has_floor(parts: Sequence[Part]) -> bool:
    """Whether faces that look up, at the bottom, cover half of the area on which the scene stands."""
    low, high = bounds(parts)
    highest, area = low[2] + _LOWEST * (high[2] - low[2]), 0.0
    for part in parts:
        a, b, c = (part.vertices[:, 2] <= highest)[part.faces].T
        corners = part.vertices[part.faces[a & b & c]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area += normal[normal[:, 2] > 0.9 * np.linalg.norm(normal, axis=1), 2].sum() / 2
    return bool(area >= 0.5 * np.prod((high - low)[:2]))


def _panel(name: str, centre: np.ndarray, u: np.ndarray, v: np.ndarray) -> Part:
    """A square about its centre along two unit vectors; surfaces are lit on either side."""
    steps = np.linspace(-_HALF, _HALF, _SQUARES + 1)
    vertices = centre + steps[None, :, None] * u + steps[:, None, None] * v
    index = np.arange((_SQUARES + 1) ** 2).reshape(_SQUARES + 1, -1)
    a, b, c, d = (corner.reshape(-1) for corner in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Part(name, vertices.reshape(-1, 3), faces, plain_material(len(faces)), smooth=False)
