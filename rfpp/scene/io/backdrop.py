"""Backdrops for scenes without surroundings: a floor, or a floor and two walls.

Without a backdrop, a lone object receives no indirect light and casts no visible shadow.
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

#: Half the side of a panel, slightly more than in training scenes; squares along a side.
_HALF, _SQUARES = 0.8, 8
#: Distance between the floor and the scene, so that no surfaces coincide.
_GAP = 0.002
#: Faces in this lowest share of a scene's height may be a floor.
_LOWEST = 0.05
_NAMES = {"floor": "a floor", "corner": "a floor and two walls"}


def with_backdrop(scene: ImportedScene, backdrop: Backdrop, path: Path) -> ImportedScene:
    """Add a gray, matte backdrop to a framed scene without camera, light and floor, with a warning."""
    surrounded = scene.cameras or scene.punctual_lights or any(part.is_light for part in scene.parts)
    if backdrop == "none" or surrounded or _has_floor(scene.parts):
        return scene
    low, high = bounds(scene.parts)
    x, y, _ = (low + high) / 2
    floor = np.array([x, y, low[2] - _GAP])
    right, back, up = np.eye(3)
    panels = [("floor", floor, right, back)]
    if backdrop == "corner":  # behind, as seen by the default camera
        panels += [("back_wall", floor + _HALF * (back + up), right, up)]
        panels += [("left_wall", floor + _HALF * (up - right), up, back)]
    warnings.warn(f"{path}: no surroundings: {_NAMES[backdrop]} is added (backdrop=none omits it)", stacklevel=4)
    parts = [_panel(name, center, u, v) for name, center, u, v in panels]
    return ImportedScene(scene.name, (*scene.parts, *parts), scene.punctual_lights, scene.cameras)


def _has_floor(parts: Sequence[Part]) -> bool:
    """Return whether upward faces at the bottom cover half of the scene's base area."""
    low, high = bounds(parts)
    highest, area = low[2] + _LOWEST * (high[2] - low[2]), 0.0
    for part in parts:
        is_low = part.vertices[:, 2] <= highest
        if not is_low.any():
            continue
        a, b, c = is_low[part.faces].T
        corners = part.vertices[part.faces[a & b & c]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area += normal[normal[:, 2] > 0.9 * np.linalg.norm(normal, axis=1), 2].sum() / 2
    return bool(area >= 0.5 * np.prod((high - low)[:2]))


def _panel(name: str, center: np.ndarray, u: np.ndarray, v: np.ndarray) -> Part:
    """Return a square around `center`, spanned by two unit vectors."""
    steps = np.linspace(-_HALF, _HALF, _SQUARES + 1)
    vertices = center + steps[None, :, None] * u + steps[:, None, None] * v
    index = np.arange((_SQUARES + 1) ** 2).reshape(_SQUARES + 1, -1)
    a, b, c, d = (corner.reshape(-1) for corner in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Part(name, vertices.reshape(-1, 3), faces, plain_material(len(faces)), smooth=False)
