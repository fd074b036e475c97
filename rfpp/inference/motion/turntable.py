"""Turntable and Swing: around a scene, or to and fro before it."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from rfpp.inference.motion.frames import Frames, Load, Motion, with_cameras
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import SceneTriangles


class _Orbit(Motion):
    """The camera moves about the vertical axis through the middle of the scene.

    It keeps its height, its distance from the axis and what it looks at on it. The first frame is the camera's own, and
    the one after the last would be the first again, so that the film can be looped.
    """

    frames: Annotated[int, Field(ge=1)]

    @abstractmethod
    def _angle(self, share: float) -> float:
        """In radians, counter-clockwise from above, after this share of the film."""

    def frames_of(self, scene: Path, camera: int, load: Load = load_scene) -> Frames:
        start = with_cameras(load(scene), scene, [camera])
        middle = _middle(start.triangles)

        def at(number: int) -> PackedScene:
            turn = _about_vertical(self._angle(number / self.frames), middle)
            return replace(start, c2w=(turn @ start.c2w.astype(np.float64)).astype(np.float32))

        return Frames(self.frames, at)


class Turntable(_Orbit):
    """Once around the scene, at even speed.

    Attributes:
        frames: of the turn.
    """

    @property
    def name(self) -> str:
        return "turntable"

    def _angle(self, share: float) -> float:
        return 2 * math.pi * share


class Swing(_Orbit):
    """To one side, to the other and back, for scenes that have walls behind them.

    Attributes:
        frames: of the whole way.
        degrees: from one side to the other.
    """

    degrees: Annotated[float, Field(gt=0, le=360)]

    @property
    def name(self) -> str:
        return "swing"

    def _angle(self, share: float) -> float:
        return math.radians(self.degrees) / 2 * math.sin(2 * math.pi * share)


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
