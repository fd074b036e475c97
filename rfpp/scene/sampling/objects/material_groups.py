"""Split a mesh by material and prepare the parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from rfpp.errors import SceneError
from rfpp.scene.io.imported_scene import z_up
from rfpp.scene.io.mesh_files import load_material_groups
from rfpp.scene.mesh import Mesh, decimated, joined, normalized_together
from rfpp.scene.sampling.objects.preparation import (
    Preparation,
    PreparedMesh,
    RejectionError,
    cleaned,
    facing_outwards,
    readable,
)
from rfpp.scene.sampling.objects.refinement import is_closed
from rfpp.scene.sampling.objects.solid import closed_decimation

#: A part with less of an object's area than this is no part of its own.
_LEAST_AREA = 0.02
_LEAST_FACES = 12


@dataclass(frozen=True)
class MaterialGroups(Preparation):
    """An object has as many parts as materials, up to `most_parts`: a lamp its foot and its shade.

    The largest stay, the others join the nearest of them. The tier's faces are shared out among the parts in
    proportion to what they have.

    Attributes:
        most_parts: of one object.
        up: the axis that points up in the files, "y" or "z"; prepared objects stand on z.
    """

    most_parts: int
    up: str

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.most_parts < 1:
            raise SceneError(f"MaterialGroups.most_parts is {self.most_parts}: use 1 or more")
        if self.up not in ("y", "z"):
            raise SceneError(f"MaterialGroups.up is '{self.up}': choose y or z")

    def __call__(self, path: Path) -> PreparedMesh:
        """Prepare the mesh in a file. Raises RejectionError."""
        groups = readable(load_material_groups, path)
        solid = [mesh for group in groups if (mesh := _with_area(group)) is not None]
        if not solid:
            raise RejectionError("degenerate", "every triangle has zero area")
        self._require_body(joined(solid))
        watertight = all(self._watertight(group) for group in solid)
        parts = self._in_parts([self._turned(group) for group in solid])
        return PreparedMesh(normalized_together(parts), sum(map(len, groups)), watertight)

    def _turned(self, part: Mesh) -> Mesh:
        return part if self.up == "z" else Mesh(z_up(part.vertices), part.faces)

    def _in_parts(self, groups: list[Mesh]) -> list[Mesh]:
        """As many as can be had within the tier: a part that cannot be reduced to its share joins another."""
        for most in range(min(self.most_parts, len(groups)), 0, -1):
            parts = _largest(groups, most)
            total = sum(map(len, parts))
            try:
                shares = face_shares([len(part) for part in parts], self.max_faces) if total > self.max_faces else []
                return [self._reduced(part, share) for part, share in zip_longest(parts, shares)]
            except SceneError as error:
                problem = str(error)
        raise RejectionError("cannot be decimated", problem)

    def _reduced(self, part: Mesh, faces: int | None) -> Mesh:
        """At most so many faces, closed if it was and if that can be had."""
        closed = is_closed(part)
        part = facing_outwards(part, closed)
        if faces is None:
            return part
        try:
            return closed_decimation(part, faces) if closed else decimated(part, faces)
        except SceneError:
            if not closed or self.non_watertight == "reject":
                raise
            return decimated(part, faces)


def face_shares(counts: Sequence[int], total: int) -> list[int]:
    """At most `total` faces shared out in proportion to `counts`: even numbers, and enough for a box each.

    Raises:
        SceneError: there are not enough for that.
    """
    left = total - _LEAST_FACES * len(counts)
    if left < 0:
        raise SceneError(f"{total} faces are too few for {len(counts)} parts: give more")
    return [_LEAST_FACES + int(left * count / sum(counts)) // 2 * 2 for count in counts]


def _with_area(group: Mesh) -> Mesh | None:
    try:
        return cleaned(group)
    except RejectionError:
        return None


def _largest(groups: list[Mesh], most: int) -> list[Mesh]:
    """The largest by area, each with the smaller ones that are nearest to it."""
    areas = np.array([_area(group) for group in groups])
    kept = [i for i in np.argsort(-areas, kind="stable")[:most] if areas[i] >= _LEAST_AREA * areas.sum()]
    trees = [cKDTree(groups[i].vertices) for i in kept]
    joining = [[groups[i]] for i in kept]
    for i in sorted(set(range(len(groups))) - set(kept)):
        distances = [tree.query(groups[i].vertices)[0].min() for tree in trees]
        joining[int(np.argmin(distances))].append(groups[i])
    return [joined(together) for together in joining]


def _area(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(mesh.corners.astype(np.float64), 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2)
