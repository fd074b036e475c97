"""Libraries of prepared objects on disk: an index and one file per mesh.

<root>/library.json                 the objects, their parts, the rejected ones, counts
<root>/meshes/<xx>/<key>.safetensors    vertices float32 [V, 3], faces int32 [F, 3]; where an object has several parts,
                                        also the number of faces of each, part_faces int32 [P]
<root>/records/<xx>/<key>.json          what became of each original: makes preparation resumable
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import safetensors.numpy
from pydantic import BaseModel, ConfigDict, ValidationError

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, joined, taken_apart
from rfpp.scene.sampling.objects.preparation import Reason
from rfpp.scene.spec import first_problem

INDEX = "library.json"


class StrictModel(BaseModel):
    """A part of the files that are written here: immutable, unknown keys refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Prepared(StrictModel):
    """An original that became an object.

    Attributes:
        id: its path in the folder, or its uid.
        sha256: of the original file.
        mesh_sha256: of the prepared mesh's file.
        faces_before, faces: of the original and of the prepared mesh.
        watertight: every edge of the original touches two faces.
        parts: pieces of it that get materials of their own.
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
    """An original that did not."""

    id: str
    sha256: str | None
    reason: Reason
    detail: str


class Index(StrictModel):
    """The content of library.json, sorted by id. `settings` and `attribution` are those of its source."""

    version: Literal[1]
    settings: dict[str, Any]
    counts: dict[str, int]
    objects: tuple[LibraryObject, ...]
    rejected: tuple[Rejected, ...]
    attribution: dict[str, Any] = {}


@dataclass(frozen=True, eq=False)
class Library:
    """A prepared library.

    Attributes:
        root: its folder.
        index: what is in it.
        hash: sha256 of library.json, which names the hash of every mesh.
    """

    root: Path
    index: Index
    hash: str

    @classmethod
    def load(cls, root: Path) -> Library:
        """Read the index, or take the one read before if the file is the same. Raises SceneError."""
        try:
            changed = (root / INDEX).stat().st_mtime_ns
        except OSError:
            raise SceneError(f"{root / INDEX}: there is no such library") from None
        return _loaded(root, changed)

    @cached_property
    def ids(self) -> frozenset[str]:
        """Of all originals, rejected or not."""
        return frozenset(entry.id for entry in (*self.index.objects, *self.index.rejected))

    def part(self, held_out: bool) -> tuple[LibraryObject, ...]:
        """The objects of test scenes, or of training scenes."""
        return self._parts["held_out" if held_out else "train"]

    @cached_property
    def _parts(self) -> dict[str, tuple[LibraryObject, ...]]:
        return {part: tuple(item for item in self.index.objects if item.part == part) for part in ("train", "held_out")}

    def parts(self, item: Prepared) -> tuple[Mesh, ...]:
        """The prepared object, in its parts. Raises SceneError if its file is missing or damaged."""
        path = mesh_path(self.root, item.id)
        try:
            content = path.read_bytes()
        except OSError as error:
            raise SceneError(f"{path}: cannot be read ({error.strerror}): prepare the library again") from None
        if hashlib.sha256(content).hexdigest() != item.mesh_sha256:
            raise SceneError(f"{path}: is damaged, its sha256 is another: prepare the library again")
        arrays = safetensors.numpy.load(content)
        whole = Mesh(arrays["vertices"], arrays["faces"])
        return taken_apart(whole, arrays["part_faces"]) if "part_faces" in arrays else (whole,)


def encoded_mesh(parts: Sequence[Mesh]) -> bytes:
    """The content of a mesh's file; equal objects are equal bytes."""
    whole = joined(parts)
    arrays = {"vertices": whole.vertices, "faces": whole.faces}
    if len(parts) > 1:
        arrays["part_faces"] = np.array([len(part) for part in parts], np.int32)
    return safetensors.numpy.save(arrays)


def mesh_path(root: Path, original_id: str) -> Path:
    """Where the prepared mesh of an original is."""
    return _path(root / "meshes", original_id, "safetensors")


def record_path(root: Path, original_id: str) -> Path:
    """Where it is noted what became of an original."""
    return _path(root / "records", original_id, "json")


def _path(folder: Path, original_id: str, suffix: str) -> Path:
    key = hashlib.sha256(original_id.encode()).hexdigest()[:32]  # any id makes a file name, folders stay small
    return folder / key[:2] / f"{key}.{suffix}"


@lru_cache(maxsize=4)
def _loaded(root: Path, _changed: int) -> Library:
    path = root / INDEX
    content = path.read_bytes()
    try:
        index = Index(**json.loads(content))
    except (ValueError, TypeError) as error:
        problem = first_problem(error) if isinstance(error, ValidationError) else error
        raise SceneError(f"{path}: is damaged ({problem}): delete it and prepare again") from None
    return Library(root, index, hashlib.sha256(content).hexdigest())
