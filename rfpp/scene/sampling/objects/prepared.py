"""Sources whose objects are prepared before any scene is drawn."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, decimated, normalized
from rfpp.scene.sampling.objects.library import Library
from rfpp.scene.sampling.objects.preparation import Preparation
from rfpp.scene.sampling.objects.refinement import refined
from rfpp.scene.sampling.objects.solid import closed_decimation

#: Objects drawn for one place in a scene before the request counts as impossible.
_ATTEMPTS = 100


@dataclass(frozen=True)
class Original:
    """A foreign mesh.

    Attributes:
        id: names it in the library, on every machine.
        stamp: another one after the mesh has changed.
        path: its file; None if it could not be had.
    """

    id: str
    stamp: str
    path: Path | None = None


@dataclass(frozen=True)
class PreparedObjects(ABC):
    """Objects of a library that `rfpp.scene.sampling.objects.building.prepare` makes.

    Attributes:
        root: folder of libraries.
        held_out: share of the objects that only test scenes show.
        preparation: see there.
    """

    root: str
    held_out: float
    preparation: Preparation

    def __post_init__(self) -> None:
        if not 0 < self.held_out < 1:
            raise SceneError(f"{type(self).__name__}.held_out is {self.held_out}: choose a share between 0 and 1")

    @property
    @abstractmethod
    def name(self) -> str:
        """Of the library."""

    @abstractmethod
    def originals(self) -> list[Original]:
        """All meshes of this source, by id, without opening any. Raises UserError."""

    @abstractmethod
    def fetched(self, originals: Iterable[Original]) -> Iterator[Original]:
        """The same with their paths, in the same order, fetched as they are asked for. Raises UserError."""

    @abstractmethod
    def origin(self) -> dict[str, Any]:
        """What names the originals, as JSON that is the same on every machine."""

    @property
    def library_root(self) -> Path:
        """The library's folder."""
        return Path(self.root) / self.name

    def settings(self) -> dict[str, Any]:
        """What the library depends on besides the originals' bytes."""
        return {"origin": self.origin(), "held_out": self.held_out, "preparation": asdict(self.preparation)}

    def library(self) -> Library:
        """The prepared library.

        Raises:
            SceneError: there is none, or it was made with other settings; how to make it.
        """
        command = "make it with `python launch/generate.py … action=prepare`"
        library = None
        if self.library_root.is_dir():
            try:
                library = Library.load(self.library_root)
            except SceneError as error:
                raise SceneError(f"{error}: {command}") from None
        if library is None:
            raise SceneError(f"{self.library_root}: this library of objects is not prepared: {command}")
        if library.index.settings != self.settings():
            raise SceneError(f"{self.library_root}: this library was prepared with other settings: {command}")
        return library

    def is_prepared(self) -> bool:
        """Whether scenes can be drawn: the library is there, made with these settings."""
        try:
            self.library()
        except SceneError:
            return False
        return True

    def content(self) -> dict[str, Any]:
        """The hash of the library."""
        return {"library": self.library().hash}

    def sample(self, rng: np.random.Generator, target_faces: int, held_out: bool) -> Mesh:
        """A random object of the library, decimated or refined to `target_faces` faces or one below.

        An object that cannot be reduced so far, or not without holes, gives way to the next draw.
        """
        library = self.library()
        objects = library.part(held_out)
        for _ in range(_ATTEMPTS):
            item = objects[int(rng.integers(len(objects)))]
            whole = library.mesh(item)
            try:
                coarse = (closed_decimation if item.watertight else decimated)(whole, target_faces)
            except SceneError:
                continue
            mesh = refined(coarse, target_faces)
            if target_faces - len(mesh) <= 1:
                return normalized(mesh)
        raise SceneError(
            f"{self.library_root}: none of {_ATTEMPTS} objects can have {target_faces} faces: "
            "raise scene.budget.per_object or bring other meshes"
        )
