"""Objects of training scenes in test scenes too: what test scenes of other objects are to be compared with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.objects.object_source import ObjectSource


@dataclass(frozen=True)
class TrainingObjects:
    """Holds nothing out.

    A test scene has the room, lights, cameras and numbers of triangles that it has with the source itself, so that
    errors of the two differ by the objects (and, where these have several parts, by their materials).

    Attributes:
        source: where the objects are from.
    """

    source: ObjectSource

    def sample(self, rng: np.random.Generator, target_faces: int, held_out: bool) -> tuple[Mesh, ...]:
        """One of the source's for training, in its parts."""
        return self.source.sample(rng, target_faces, held_out=False)

    def account(self, configured: Mapping[str, Any]) -> dict[str, Any]:
        """That of the source, and that none of its objects are held out."""
        return {"held_out": "none", "source": self.source.account(configured["source"])}

    def libraries(self) -> tuple[Any, ...]:
        """The source's."""
        return self.source.libraries()
