"""Objects of several sources in one scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.objects.object_source import ObjectSource


@dataclass(frozen=True)
class MixedObjects:
    """Each object comes from one of the sources, by chance.

    Attributes:
        sources: by a name of your own.
        shares: of the objects that come from each; they need not add up to 1.
    """

    sources: Mapping[str, ObjectSource]
    shares: Mapping[str, float]

    def __post_init__(self) -> None:
        if not self.sources or set(self.sources) != set(self.shares):
            raise SceneError(
                f"MixedObjects: shares are given of {', '.join(self.shares) or 'nothing'}, sources are "
                f"{', '.join(self.sources) or 'none'}: give each source a share"
            )
        if min(self.shares.values()) < 0 or sum(self.shares.values()) <= 0:
            raise SceneError("MixedObjects.shares: use numbers of 0 or more, not all of them 0")

    def sample(self, rng: np.random.Generator, target_faces: int, held_out: bool) -> tuple[Mesh, ...]:
        """An object of one of the sources, in its parts."""
        names = sorted(self.sources)
        shares = np.array([self.shares[name] for name in names])
        chosen = names[int(rng.choice(len(names), p=shares / shares.sum()))]
        return self.sources[chosen].sample(rng, target_faces, held_out)

    def account(self, configured: Mapping[str, Any]) -> dict[str, Any]:
        """The configuration, with what each source says of itself."""
        sources = {name: source.account(configured["sources"][name]) for name, source in self.sources.items()}
        return {**configured, "sources": sources}

    def libraries(self) -> tuple[Any, ...]:
        """Those of all sources."""
        return sum((source.libraries() for source in self.sources.values()), ())
