"""What a scene family asks of a source of objects."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np

from rfpp.scene.mesh import Mesh


@runtime_checkable
class ObjectSource(Protocol):
    """Objects that were divided into those for training and those for test scenes before any scene is drawn."""

    def sample(self, rng: np.random.Generator, target_faces: int, held_out: bool) -> Mesh:
        """A random object, held out for test scenes or not, as a normalised mesh of at most `target_faces` faces.

        It misses that number by one at most, where a closed mesh cannot have an odd one.
        """
        ...

    def content(self) -> dict[str, Any]:
        """What the meshes depend on besides the source's configuration, as JSON: part of a data set's fingerprint."""
        ...
