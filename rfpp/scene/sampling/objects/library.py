"""Libraries of prepared objects on disk: an index and one file per mesh.

<root>/library.json                 the objects, their parts, the rejected ones, counts
<root>/meshes/<xx>/<key>.safetensors    vertices float32 [V, 3], faces int32 [F, 3]; for an object of several parts
                                        also the number of faces of each, part_faces int32 [P]
<root>/records/<xx>/<key>.json          the outcome for each original, so that preparation resumes
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import safetensors.numpy
from pydantic import BaseModel, ConfigDict, ValidationError

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, joined, split_faces
from rfpp.scene.sampling.objects.preparation import Reason
from rfpp.scene.spec import first_problem

INDEX = "library.json"


class StrictModel(BaseModel):
    """Base class of the files' contents: immutable, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Prepared(StrictModel):
    """An original that became an object.

    Attributes:
        mesh_sha256: hash of the prepared mesh's file.
        watertight: every edge of the original touches two faces.
    """

    id: str
    sha256: str
    mesh_sha256: str
    faces_before: int
    faces: int
    watertight: bool
    parts: int = 1


class LibraryObject(Prepared):
    """An object of the library, for training scenes or held out for test scenes."""

    part: Literal["train", "held_out"]


class Rejected(StrictModel):
    """An original that was rejected."""

    id: str
    sha256: str | None
    reason: Reason
    detail: str


class Index(StrictModel):
    """The content of library.json, sorted by id. `settings` and `attribution` come from the source."""

    version: Literal[1]
    settings: dict[str, Any]
    counts: dict[str, int]
    objects: tuple[LibraryObject, ...]
    rejected: tuple[Rejected, ...]
    attribution: dict[str, Any] = {}


@dataclass(frozen=True, eq=False)
class Library:
    """A prepared library."""

    root: Path
    index: Index
    hash: str

    @classmethod
    def load(cls, root: Path) -> Library:
        """Read the index; an unchanged file is read once. Raises SceneError."""
        try:
            modified = (root / INDEX).stat().st_mtime_ns
        except OSError:
            raise SceneError(f"{root / INDEX}: there is no such library") from None
        return _loaded(root, modified)

    @cached_property
    def ids(self) -> frozenset[str]:
        """Ids of all originals, including rejected ones."""
        return frozenset(entry.id for entry in (*self.index.objects, *self.index.rejected))

    def part(self, held_out: bool) -> tuple[LibraryObject, ...]:
        """Return the objects of test scenes, or of training scenes."""
        return self._parts["held_out" if held_out else "train"]

    @cached_property
    def _parts(self) -> dict[str, tuple[LibraryObject, ...]]:
        return {part: tuple(item for item in self.index.objects if item.part == part) for part in ("train", "held_out")}

    def parts(self, item: Prepared) -> tuple[Mesh, ...]:
        """Read the parts of an object. Raises SceneError if its file is missing or damaged."""
        path = mesh_path(self.root, item.id)
        try:
            content = path.read_bytes()
        except OSError as error:
            raise SceneError(f"{path}: cannot be read ({error.strerror}): prepare the library again") from None
        if hashlib.sha256(content).hexdigest() != item.mesh_sha256:
            raise SceneError(f"{path}: is damaged (other sha256): prepare the library again")
        arrays = safetensors.numpy.load(content)
        whole = Mesh(arrays["vertices"], arrays["faces"])
        return split_faces(whole, arrays["part_faces"]) if "part_faces" in arrays else (whole,)


def encoded_mesh(parts: Sequence[Mesh]) -> bytes:
    """Return the content of a mesh's file; equal objects give equal bytes."""
    whole = joined(parts)
    arrays = {"vertices": whole.vertices, "faces": whole.faces}
    if len(parts) > 1:
        arrays["part_faces"] = np.array([len(part) for part in parts], np.int32)
    return safetensors.numpy.save(arrays)


def mesh_path(root: Path, original_id: str) -> Path:
    """Return the path of an original's prepared mesh."""
    return _path(root / "meshes", original_id, "safetensors")


def record_path(root: Path, original_id: str) -> Path:
    """Return the path of the record of an original's outcome."""
    return _path(root / "records", original_id, "json")


def _path(folder: Path, original_id: str, suffix: str) -> Path:
    key = hashlib.sha256(original_id.encode()).hexdigest()[:32]  # any id gives a valid name; folders stay small
    return folder / key[:2] / f"{key}.{suffix}"


@lru_cache(maxsize=4)
def _loaded(root: Path, _modified: int) -> Library:
    path = root / INDEX
    content = path.read_bytes()
    try:
        index = Index.model_validate_json(content)
    except ValidationError as error:
        raise SceneError(f"{path}: is damaged ({first_problem(error)}): delete it and prepare again") from None
    return Library(root, index, hashlib.sha256(content).hexdigest())
