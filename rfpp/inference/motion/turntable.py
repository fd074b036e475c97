"""Turntable: once around a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from rfpp.inference.motion.frames import Frames, Motion, with_cameras
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Scene
from rfpp.scene.triangles import SceneTriangles


class Turntable(Motion):
    """The camera goes once around the vertical axis through the middle of the scene, counter-clockwise from above.

    It keeps its height, its distance from the axis and what it looks at on it: the first frame is the camera's own, and
    the one after the last would be the first again, so that the film can be looped.

    Attributes:
        frames: of one turn.
    """

    frames: Annotated[int, Field(ge=1)]

    @property
    def name(self) -> str:
        return "turntable"

    def frames_of(self, scene: Path, camera: int) -> Sequence[PackedScene]:
        start = with_cameras(Scene.load(scene), [camera])
        middle = _middle(start.triangles)

        def at(number: int) -> PackedScene:
            turn = _about_vertical(2 * np.pi * number / self.frames, middle)
            return replace(start, c2w=(turn @ start.c2w.astype(np.float64)).astype(np.float32))

        return Frames(self.frames, at)


def _middle(triangles: SceneTriangles) -> Float[np.ndarray, " 3"]:
    """Of the bounding box of what can be seen; lights, which cannot, often stand far away on one side."""
    visible = triangles.positions[~triangles.is_emissive].reshape(-1, 3)
    corners = visible if len(visible) else triangles.positions.reshape(-1, 3)
    return (corners.min(axis=0) + corners.max(axis=0)).astype(np.float64) / 2


def _about_vertical(angle: float, point: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    """The rotation by `angle` about the vertical line through `point`."""
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    turn[:3, 3] = point - turn[:3, :3] @ point
    return turn
