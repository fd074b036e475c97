"""Procedural objects: a finite pool of closed solids, each a function of its number alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rfpp.errors import SceneError
from rfpp.ranges import PartOfMany, Positive, Share
from rfpp.scene.mesh import Mesh, normalized
from rfpp.scene.sampling.objects.constructed import bevelled, carved, crystal, primitive
from rfpp.scene.sampling.objects.deformation import deformed
from rfpp.scene.sampling.objects.smooth import metaballs, pebble, superellipsoid, supertoroid
from rfpp.scene.sampling.objects.solid import Rng, Solid, from_manifold, is_solid, unit_sphere, with_face_count
from rfpp.scene.sampling.objects.swept import extrusion, lathe, tube

#: Kinds of solids by name, in documentation order.
KINDS: dict[str, Solid] = {
    solid.__name__: solid
    for solid in (
        superellipsoid,
        pebble,
        supertoroid,
        metaballs,
        lathe,
        extrusion,
        tube,
        carved,
        bevelled,
        primitive,
        crystal,
    )
}

#: Part of every object's seed, distinct from scenes' seeds.
_STREAM = 0x0B1EC7
#: Solids drawn for one object before it becomes a sphere, which always succeeds.
_ATTEMPTS = 8
#: Minimum share of its bounding box filled by a solid.
_LEAST_FILL = 0.02


@dataclass(frozen=True)
class ProceduralObjects:
    """`pool` closed solids, the last of which are held out for test scenes."""

    kinds: Sequence[str]
    pool: Positive
    held_out: PartOfMany
    stretched: Share
    deformed: Share

    def __post_init__(self) -> None:
        if not self.kinds:
            raise SceneError(f"ProceduralObjects.kinds: the list is empty: choose from {', '.join(KINDS)}")
        for kind in self.kinds:
            if kind not in KINDS:
                raise SceneError(f"ProceduralObjects.kinds: unknown kind '{kind}': choose from {', '.join(KINDS)}")
        object.__setattr__(self, "kinds", tuple(self.kinds))
        if not 0 < self.training_objects < self.pool:
            raise SceneError(
                f"ProceduralObjects: {self.held_out:g} of {self.pool} objects held out leaves one part empty: "
                "choose a share between 0 and 1 and a larger pool"
            )

    @property
    def training_objects(self) -> int:
        """Number of training objects; the remaining ones are for test scenes."""
        return self.pool - round(self.pool * self.held_out)

    def sample(self, rng: Rng, target_faces: int, held_out: bool) -> tuple[Mesh, ...]:
        """Return a random object of the pool, in one part."""
        first, end = (self.training_objects, self.pool) if held_out else (0, self.training_objects)
        return (self.mesh(int(rng.integers(first, end)), target_faces),)

    def mesh(self, number: int, target_faces: int) -> Mesh:
        """Return object `number` with `target_faces` faces, or one less if that is odd: closed and normalized.

        Raises:
            SceneError: If `target_faces` is below 12.
        """
        if target_faces < 12:
            raise SceneError(f"{target_faces} triangles are too few for a procedural object: ask for 12 or more")
        for attempt in range(_ATTEMPTS):
            rng = np.random.default_rng([_STREAM, number, attempt])
            try:
                mesh = normalized(with_face_count(self._solid(rng, target_faces), target_faces))
            except SceneError:  # a rare solid cannot be decimated that far
                continue
            if len(mesh) == target_faces - target_faces % 2 and is_solid(mesh, _LEAST_FILL):
                return mesh
        return normalized(with_face_count(from_manifold(unit_sphere(target_faces)), target_faces))

    def account(self, configured: Mapping[str, Any]) -> dict[str, Any]:
        return dict(configured)

    def libraries(self) -> tuple[()]:
        return ()

    def _solid(self, rng: Rng, target_faces: int) -> Mesh:
        mesh = KINDS[self.kinds[int(rng.integers(len(self.kinds)))]](rng, target_faces)
        if rng.random() < self.stretched:
            mesh = Mesh(mesh.vertices * rng.uniform(0.5, 1.0, 3), mesh.faces)
        return deformed(rng, mesh, target_faces) if rng.random() < self.deformed else mesh
