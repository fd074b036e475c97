"""Interface of object sources."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np

from rfpp.scene.mesh import Mesh


@runtime_checkable
class ObjectSource(Protocol):
    """Objects that were divided into those for training and those for test scenes before any scene is drawn."""

    def sample(self, rng: np.random.Generator, target_faces: int, held_out: bool) -> tuple[Mesh, ...]:
        """A random object, held out for test scenes or not, of at most `target_faces` faces.

        Returns its parts, each of which gets a material of its own; together they are normalised. Each part misses
        its share of the faces by one at most, where a closed mesh cannot have an odd number.
        """
        ...

    def account(self, configured: Mapping[str, Any]) -> dict[str, Any]:
        """What the meshes depend on, as JSON: part of a data set's fingerprint. `configured` is the source in YAML."""
        ...

    def libraries(self) -> tuple[Any, ...]:
        """What is in it of `PreparedObjects`, which have to be prepared before any scene is drawn."""
        ...
