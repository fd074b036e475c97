"""Object sources: the interface, and mixtures of sources."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh


@runtime_checkable
class ObjectSource(Protocol):
    """Objects, divided into training objects and objects held out for test scenes before any scene is drawn."""

    def sample(self, rng: np.random.Generator, target_faces: int, held_out: bool) -> tuple[Mesh, ...]:
        """Return the parts of a random object with at most `target_faces` faces in total.

        Each part has its own material; together they are normalized. A part may have one face less than its share,
        because closed meshes have an even number of faces.
        """
        ...

    def account(self, configured: Mapping[str, Any]) -> dict[str, Any]:
        """Return a JSON-able account of the meshes, part of a data set's fingerprint."""
        ...

    def libraries(self) -> tuple[Any, ...]:
        """Return the `LibraryObjects` in it, whose libraries must be built before any scene is drawn."""
        ...


@dataclass(frozen=True)
class MixedObjects:
    """A random choice between several sources for each object."""

    sources: Mapping[str, ObjectSource]
    shares: Mapping[str, float]

    def __post_init__(self) -> None:
        if not self.sources or set(self.sources) != set(self.shares):
            raise SceneError(
                f"MixedObjects: shares: {', '.join(self.shares) or 'none'}; sources: "
                f"{', '.join(self.sources) or 'none'}: give each source a share"
            )
        if min(self.shares.values()) < 0 or sum(self.shares.values()) <= 0:
            raise SceneError("MixedObjects.shares: use numbers of 0 or more, not all of them 0")

    def sample(self, rng: np.random.Generator, target_faces: int, held_out: bool) -> tuple[Mesh, ...]:
        names = sorted(self.sources)
        shares = np.array([self.shares[name] for name in names])
        chosen = names[int(rng.choice(len(names), p=shares / shares.sum()))]
        return self.sources[chosen].sample(rng, target_faces, held_out)

    def account(self, configured: Mapping[str, Any]) -> dict[str, Any]:
        sources = {name: source.account(configured["sources"][name]) for name, source in self.sources.items()}
        return {**configured, "sources": sources}

    def libraries(self) -> tuple[Any, ...]:
        return sum((source.libraries() for source in self.sources.values()), ())
