"""Prepare one imported mesh: clean up, check and decimate it, or reject it with a reason."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
import trimesh

from rfpp.errors import SceneError
from rfpp.scene.io.mesh_files import load_mesh
from rfpp.scene.mesh import Mesh, decimated, normalized, welded, without_degenerate_faces
from rfpp.scene.sampling.objects.refinement import is_closed
from rfpp.scene.sampling.objects.solid import closed_decimation, volume

#: An object thinner than this share of its longest side, or that fills less of its box, has nothing inside.
_FLAT = 1e-3

T = TypeVar("T")

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
    """A mesh that is no object for scenes.

    Attributes:
        reason: to be counted.
        detail: what exactly, for people.
    """

    def __init__(self, reason: Reason, detail: str) -> None:
        super().__init__(f"{reason}: {detail}")
        self.reason: Reason = reason
        self.detail = detail


@dataclass(frozen=True, eq=False)
class PreparedMesh:
    """What became of a mesh.

    Attributes:
        parts: together normalised, with at most the tier's number of faces, facing outwards where it is watertight.
        faces_before: of the file.
        watertight: every edge of the original touches two faces.
    """

    parts: tuple[Mesh, ...]
    faces_before: int
    watertight: bool


@dataclass(frozen=True)
class Preparation:
    """How meshes are prepared, and which ones are.

    Attributes:
        max_faces: the triangle tier; a mesh with more faces is decimated.
        min_faces: a mesh with fewer faces after clean-up is rejected.
        non_watertight: whether to "reject" or to "keep" meshes with holes, open edges or edges of three faces.
    """

    max_faces: int
    min_faces: int
    non_watertight: str

    def __post_init__(self) -> None:
        if not 1 <= self.min_faces <= self.max_faces:
            raise SceneError(f"Preparation: {self.min_faces}…{self.max_faces} faces are no range: use 1 <= min <= max")
        if self.non_watertight not in ("reject", "keep"):
            raise SceneError(f"Preparation.non_watertight is '{self.non_watertight}': choose reject or keep")

    def __call__(self, path: Path) -> PreparedMesh:
        """Prepare the mesh in a file. Raises RejectionError."""
        original = readable(load_mesh, path)
        mesh = cleaned(original)
        self._require_body(mesh)
        watertight = self._watertight(mesh)
        reduced = self._to_tier(facing_outwards(mesh, watertight), watertight)
        if watertight and volume(reduced) < _FLAT * np.prod(np.ptp(reduced.vertices, axis=0)):
            raise RejectionError("flat", "it encloses next to no volume")
        return PreparedMesh((normalized(reduced),), len(original), watertight)

    def _require_body(self, mesh: Mesh) -> None:
        if len(mesh) < self.min_faces:
            raise RejectionError("too few faces", f"{len(mesh)} after clean-up")
        sides = np.ptp(mesh.vertices, axis=0)
        if sides.min() < _FLAT * sides.max():
            raise RejectionError("flat", f"its sides are {' x '.join(f'{side:.3g}' for side in sides)}")

    def _watertight(self, mesh: Mesh) -> bool:
        watertight = is_closed(mesh)
        if not watertight and self.non_watertight == "reject":
            raise RejectionError("not watertight", "some edge does not touch exactly two faces")
        return watertight

    def _to_tier(self, mesh: Mesh, watertight: bool) -> Mesh:
        try:
            return closed_decimation(mesh, self.max_faces) if watertight else decimated(mesh, self.max_faces)
        except SceneError as error:
            raise RejectionError("cannot be decimated", str(error)) from None


def readable(reader: Callable[[Path], T], path: Path) -> T:
    """What `reader` makes of a file. Raises RejectionError where it cannot."""
    try:
        return reader(path)
    except SceneError as error:
        raise RejectionError("unreadable", str(error).removeprefix(f"{path}: ")) from None


def cleaned(mesh: Mesh) -> Mesh:
    """Coinciding vertices made one, without faces of zero area or that repeat others."""
    try:
        solid = without_degenerate_faces(welded(mesh))
    except SceneError as error:
        raise RejectionError("degenerate", str(error)) from None
    _, first = np.unique(np.sort(solid.faces, axis=1), axis=0, return_index=True)
    return Mesh(solid.vertices, solid.faces[np.sort(first)])


def facing_outwards(mesh: Mesh, watertight: bool) -> Mesh:
    """Neighbouring faces made to agree about the outside, which is turned out where there is an inside."""
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    if not surface.is_winding_consistent:
        trimesh.repair.fix_winding(surface)
        mesh = Mesh(mesh.vertices, surface.faces)
    return Mesh(mesh.vertices, mesh.faces[:, ::-1]) if watertight and volume(mesh) < 0 else mesh
