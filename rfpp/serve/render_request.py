"""What a picture is asked for with, checked before anything is made of it."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from rfpp.scene.io.limits import parse_json
from rfpp.scene.spec import Camera, Number, Strict

#: Of a picture, along each side.
MOST_PIXELS = 16384

Side = Annotated[int, Field(ge=1, le=MOST_PIXELS)]
Edge = Annotated[float, Field(ge=-1e3, le=1e3)]
Row = tuple[Number, Number, Number, Number]


class Asked(Strict):
    """A view of a scene that was sent before.

    Attributes:
        scene: as it was named when it came.
        camera_to_world: the first three rows of the matrix, in the coordinates of the scene that was sent, Z up.
        window: left, right, bottom and top of the picture in the plane at distance 1 before the camera.
        size: (height, width) in pixels.
        light_samples, supersampling: see `Renderer.render`.
        transparent: whether alpha is 0 where nothing is seen; else it is 1 everywhere.
    """

    noun = "picture"

    scene: Annotated[str, Field(max_length=64)]
    camera_to_world: tuple[Row, Row, Row]
    window: tuple[Edge, Edge, Edge, Edge]
    size: tuple[Side, Side]
    light_samples: Annotated[int, Field(ge=1, le=4096)]
    supersampling: Annotated[int, Field(ge=1, le=8)]
    transparent: bool

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Asked:
        if not np.linalg.norm(np.array(self.camera_to_world)[:, :3], axis=0).min() > 1e-9:
            raise ValueError("camera_to_world: the camera has no direction: check its scale")
        return self

    @classmethod
    def of(cls, content: bytes) -> Asked:
        """From JSON. Raises SceneError naming what is wrong."""
        return cls(**parse_json(content, "the description of a picture"))

    def camera(self, fov: float) -> Camera:
        """In the coordinates of the scene that was sent."""
        matrix = np.array(self.camera_to_world)
        _, up, backward = (axis / np.linalg.norm(axis) for axis in matrix[:, :3].T)
        position = matrix[:, 3]
        return Camera(
            position=tuple(position.tolist()),
            look_at=tuple((position - backward).tolist()),
            up=tuple(up.tolist()),
            fov=fov,
        )
