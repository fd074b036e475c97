"""Prepare an imported mesh: clean up, check, split by material and decimate it, or reject it with a reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from rfpp.errors import SceneError
from rfpp.scene.io.imported_scene import z_up
from rfpp.scene.io.mesh_files import load_material_groups, load_mesh
from rfpp.scene.mesh import (
    Mesh,
    decimated,
    joined,
    normalized_together,
    triangle_areas,
    welded,
    without_degenerate_faces,
)
from rfpp.scene.sampling.objects.refinement import is_closed
from rfpp.scene.sampling.objects.solid import closed_decimation, volume

#: An object thinner than this share of its longest side, or that fills less of its box, is flat.
_FLAT = 1e-3
#: Smaller parts, as a share of the object's area, join the nearest part.
_MIN_AREA = 0.02
_MIN_FACES = 12

Reason = Literal[
    "unreadable",
    "degenerate",
    "too few faces",
    "flat",
    "not watertight",
    "cannot be decimated",
    "duplicate",
    "not available",
    "crashed",
]


class RejectionError(Exception):
    """A mesh that cannot be an object of a scene."""

    def __init__(self, reason: Reason, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason: Reason = reason
        self.detail = detail


@dataclass(frozen=True, eq=False)
class PreparedMesh:
    """A prepared object.

    Attributes:
        parts: together normalized and with at most `max_faces` faces, facing outwards where watertight.
    """

    parts: tuple[Mesh, ...]
    faces_before: int
    watertight: bool


@dataclass(frozen=True)
class Preparation:
    """Preparation of imported meshes."""

    max_faces: int
    min_faces: int
    non_watertight: str
    most_parts: int
    up: str

    def __post_init__(self) -> None:
        if not 1 <= self.min_faces <= self.max_faces:
            raise SceneError(f"Preparation: {self.min_faces}…{self.max_faces} faces: use 1 <= min_faces <= max_faces")
        if self.non_watertight not in ("reject", "keep"):
            raise SceneError(f"Preparation.non_watertight is '{self.non_watertight}': choose reject or keep")
        if self.most_parts < 1:
            raise SceneError(f"Preparation.most_parts is {self.most_parts}: use 1 or more")
        if self.up not in ("y", "z"):
            raise SceneError(f"Preparation.up is '{self.up}': choose y or z")

    def __call__(self, path: Path) -> PreparedMesh:
        """Prepare the mesh in a file. Raises RejectionError."""
        try:
            groups = load_material_groups(path) if self.most_parts > 1 else (load_mesh(path),)
        except SceneError as error:
            raise RejectionError("unreadable", str(error).removeprefix(f"{path}: ")) from None
        solid = [mesh for group in groups if (mesh := cleaned(group)) is not None]
        if not solid:
            raise RejectionError("degenerate", "every triangle has zero area")
        if self.up == "y":
            solid = [Mesh(z_up(group.vertices), group.faces) for group in solid]
        self._require_body(joined(solid))
        watertight = all(map(is_closed, solid))
        if not watertight and self.non_watertight == "reject":
            raise RejectionError("not watertight", "some edge does not touch exactly two faces")
        parts = normalized_together(self._parts(solid))
        fills = volume(parts[0]) >= _FLAT * np.prod(np.ptp(parts[0].vertices, axis=0))
        if self.most_parts == 1 and watertight and not fills:
            raise RejectionError("flat", "its volume is close to zero")
        return PreparedMesh(parts, sum(map(len, groups)), watertight)

    def _require_body(self, mesh: Mesh) -> None:
        if len(mesh) < self.min_faces:
            raise RejectionError("too few faces", f"{len(mesh)} after clean-up")
        sides = np.ptp(mesh.vertices, axis=0)
        if sides.min() < _FLAT * sides.max():
            raise RejectionError("flat", f"its sides are {' x '.join(f'{side:.3g}' for side in sides)}")

    def _parts(self, groups: list[Mesh]) -> list[Mesh]:
        """Return as many parts as `max_faces` allows: a part that cannot be decimated to its share joins another."""
        for most in range(min(self.most_parts, len(groups)), 0, -1):
            parts = _largest(groups, most)
            counts = [len(part) for part in parts]
            try:
                shares = face_shares(counts, self.max_faces) if sum(counts) > self.max_faces else counts
                return [self._reduced(part, share) for part, share in zip(parts, shares, strict=True)]
            except SceneError as error:
                problem = str(error)
        raise RejectionError("cannot be decimated", problem)

    def _reduced(self, part: Mesh, faces: int) -> Mesh:
        """Decimate a part, keeping it closed where possible."""
        closed = is_closed(part)
        part = facing_outwards(part, closed)
        if closed and len(part) > faces:
            try:
                return closed_decimation(part, faces)
            except SceneError:
                if self.non_watertight == "reject":
                    raise
        return decimated(part, faces)


def face_shares(counts: Sequence[int], total: int) -> list[int]:
    """Divide at most `total` faces in proportion to `counts` into even numbers of at least 12.

    Raises:
        SceneError: If there are not enough faces.
    """
    if len(counts) == 1:
        return [total]
    remaining = total - _MIN_FACES * len(counts)
    if remaining < 0:
        raise SceneError(f"{total} faces are too few for {len(counts)} parts: give more")
    return [_MIN_FACES + int(remaining * count / sum(counts)) // 2 * 2 for count in counts]


def cleaned(mesh: Mesh) -> Mesh | None:
    """Merge coincident vertices and remove duplicate and zero-area faces; return None if no face is left."""
    try:
        solid = without_degenerate_faces(welded(mesh))
    except SceneError:
        return None
    _, first = np.unique(np.sort(solid.faces, axis=1), axis=0, return_index=True)
    return Mesh(solid.vertices, solid.faces[np.sort(first)])


def facing_outwards(mesh: Mesh, watertight: bool) -> Mesh:
    """Orient neighboring faces consistently, and outwards if the mesh is watertight."""
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    if not surface.is_winding_consistent:
        trimesh.repair.fix_winding(surface)
        mesh = Mesh(mesh.vertices, surface.faces)
    return Mesh(mesh.vertices, mesh.faces[:, ::-1]) if watertight and volume(mesh) < 0 else mesh


def _largest(groups: list[Mesh], most: int) -> list[Mesh]:
    """Return the largest groups by area, each joined with the smaller ones nearest to it."""
    areas = np.array([triangle_areas(group.vertices.astype(np.float64), group.faces).sum() for group in groups])
    kept = [i for i in np.argsort(-areas, kind="stable")[:most] if areas[i] >= _MIN_AREA * areas.sum()]
    trees = [cKDTree(groups[i].vertices) for i in kept]
    members = [[groups[i]] for i in kept]
    for i in sorted(set(range(len(groups))) - set(kept)):
        distances = [tree.query(groups[i].vertices)[0].min() for tree in trees]
        members[int(np.argmin(distances))].append(groups[i])
    return [joined(together) for together in members]
