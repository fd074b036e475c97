"""Description of a picture that a client requests, validated before anything is rendered."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from rfpp.scene.io.limits import parse_json
from rfpp.scene.spec import Camera, Number, Strict

Side = Annotated[int, Field(ge=1, le=16384)]
Edge = Annotated[float, Field(ge=-1e3, le=1e3)]
Row = tuple[Number, Number, Number, Number]


class RenderRequest(Strict):
    """View of a scene that was sent before; samples as for `Renderer.render`."""

    noun = "picture"

    scene: Annotated[str, Field(max_length=64)]  # name, as returned when it was sent
    camera_to_world: tuple[Row, Row, Row]  # first three rows, in the coordinates of the scene as sent, Z up
    window: tuple[Edge, Edge, Edge, Edge]  # left, right, bottom and top at distance 1 in front of the camera
    size: tuple[Side, Side]  # (height, width) in pixels
    light_samples: Annotated[int, Field(ge=1, le=4096)]
    supersampling: Annotated[int, Field(ge=1, le=8)]
    transparent: bool  # alpha is 0 where no surface is visible; otherwise it is 1 everywhere

    @model_validator(mode="after")
    def _has_a_direction(self) -> RenderRequest:
        if not np.linalg.norm(np.array(self.camera_to_world)[:, :3], axis=0).min() > 1e-9:
            raise ValueError("camera_to_world: the camera has no direction: check its scale")
        return self

    @classmethod
    def parse(cls, content: bytes) -> RenderRequest:
        """Parse JSON. Raises SceneError naming the invalid value."""
        return cls(**parse_json(content, "the description of a picture"))

    def camera(self, fov: float) -> Camera:
        """Return the camera in the coordinates of the scene as sent."""
        matrix = np.array(self.camera_to_world)
        _, up, backward = (axis / np.linalg.norm(axis) for axis in matrix[:, :3].T)
        position, look_at = matrix[:, 3], matrix[:, 3] - backward
        return Camera(position=position.tolist(), look_at=look_at.tolist(), up=up.tolist(), fov=fov)
