"""Turntable and Swing: a camera that orbits the scene."""

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


class _Orbit(Motion):
    """Rotation of the camera about the vertical axis through the center of the scene; a loop."""

    frames: Annotated[int, Field(ge=1)]

    @abstractmethod
    def _angle(self, share: float) -> float:
        """Return the angle in radians, counter-clockwise from above, after a share of the animation."""

    @property
    def name(self) -> str:
        return type(self).__name__.lower()

    def frames_of(self, scene: Path, camera: int, load: Load = load_scene) -> Frames:
        start = with_cameras(load(scene), scene, [camera])
        triangles = start.triangles
        # lights are invisible and may be far away
        is_visible = ~triangles.is_emissive if not triangles.is_emissive.all() else slice(None)
        corners = triangles.positions[is_visible].reshape(-1, 3)
        center = (corners.min(axis=0) + corners.max(axis=0)).astype(np.float64) / 2

        def create(number: int) -> PackedScene:
            turn = _rotation(self._angle(number / self.frames), center)
            return replace(start, c2w=(turn @ start.c2w.astype(np.float64)).astype(np.float32))

        return Frames(self.frames, create)


class Turntable(_Orbit):
    """Once around the scene at constant speed, in a number of frames."""

    def _angle(self, share: float) -> float:
        return 2 * math.pi * share


class Swing(_Orbit):
    """Swing to both sides, `degrees` apart, and back, in a number of frames; for scenes with walls behind them."""

    degrees: Annotated[float, Field(gt=0, le=360)]

    def _angle(self, share: float) -> float:
        return math.radians(self.degrees) / 2 * math.sin(2 * math.pi * share)


def _rotation(angle: float, point: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "4 4"]:
    """Return the rotation by `angle` about the vertical axis through a point."""
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    turn[:3, 3] = point - turn[:3, :3] @ point
    return turn
