"""Objects of a library that are named, for pictures of things that are to be in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.objects.prepared import PreparedObjects


@dataclass(frozen=True)
class ChosenObjects:
    """Some objects of a prepared source, each as likely as the others.

    Attributes:
        source: where they are from.
        ids: by which the source's library knows them.
    """

    source: PreparedObjects
    ids: Sequence[str]

    def __post_init__(self) -> None:
        if not self.ids:
            raise SceneError("family.objects.ids is empty: name objects of the library")
        object.__setattr__(self, "ids", tuple(self.ids))

    def sample(self, rng: np.random.Generator, target_faces: int, held_out: bool) -> tuple[Mesh, ...]:
        """One of them, in its parts.

        Raises SceneError: it is not among the library's objects of such scenes, or cannot have so few faces.
        """
        library = self.source.library()
        there = {item.id: item for item in library.part(held_out)}
        if unknown := set(self.ids) - there.keys():
            kind = "held-out objects" if held_out else "objects for training"
            raise SceneError(
                f"{library.root}: '{min(unknown)}' is none of its {kind}: choose ids from its library.json"
            )
        return self.source.sized(library, there[self.ids[int(rng.integers(len(self.ids)))]], target_faces)

    def account(self, configured: Mapping[str, Any]) -> dict[str, Any]:
        """That of the source, and which objects were chosen."""
        return {"ids": list(self.ids), "source": self.source.account(configured["source"])}

    def libraries(self) -> tuple[PreparedObjects, ...]:
        """The source's."""
        return self.source.libraries()
