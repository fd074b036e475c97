"""Objects of a library that is built from foreign meshes before sampling."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from rfpp.errors import SceneError
from rfpp.ranges import PartOfMany
from rfpp.scene.io.limits import MAX_TEXT_BYTES, read_member
from rfpp.scene.mesh import Mesh, decimated, normalized_together
from rfpp.scene.sampling.objects.library import Library
from rfpp.scene.sampling.objects.preparation import Preparation, face_shares
from rfpp.scene.sampling.objects.refinement import is_closed, refined
from rfpp.scene.sampling.objects.solid import closed_decimation

#: Objects drawn for one place in a scene before the request fails.
_ATTEMPTS = 100
_COMMAND = "make it with `python launch/generate.py … action=prepare`"


@dataclass(frozen=True)
class Original:
    """A foreign mesh.

    Attributes:
        id: its name in the library, the same on every machine.
        stamp: changes with the mesh.
        path: its file, or the zip archive that holds it; None if it is not available.
    """

    id: str
    stamp: str
    path: Path | None = None
    member: str | None = None

    @contextmanager
    def file(self) -> Iterator[Path]:
        """Provide the mesh's file inside the context. Raises SceneError if an archive does not hold it."""
        if self.member is None:
            yield self.path
            return
        with TemporaryDirectory() as folder:
            path = Path(folder) / f"mesh{Path(self.member).suffix.lower()}"
            path.write_bytes(read_member(self.path, self.member, MAX_TEXT_BYTES))
            yield path


@dataclass(frozen=True)
class LibraryObjects(ABC):
    """Objects of a library built by `rfpp.scene.sampling.objects.library_building.prepare`."""

    root: str
    held_out: PartOfMany
    preparation: Preparation

    def __post_init__(self) -> None:
        if not 0 < self.held_out < 1:
            raise SceneError(f"{type(self).__name__}.held_out is {self.held_out}: choose a share between 0 and 1")

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the library."""

    @abstractmethod
    def originals(self) -> list[Original]:
        """Return all meshes of this source, by id, without opening any. Raises UserError."""

    @abstractmethod
    def origin(self) -> dict[str, Any]:
        """Return a JSON-able name of the originals, the same on every machine."""

    def fetched(self, originals: Iterable[Original]) -> Iterator[Original]:
        """Yield the originals with their paths, in order, fetching them on demand. Raises UserError."""
        return iter(originals)

    def attribution(self) -> dict[str, Any]:
        """Return creators and licences of the originals as JSON; empty if unknown."""
        return {}

    @property
    def library_root(self) -> Path:
        """Folder of the library."""
        return Path(self.root) / self.name

    def settings(self) -> dict[str, Any]:
        """Return everything the library depends on, except the originals' bytes."""
        return {"origin": self.origin(), "held_out": self.held_out, "preparation": asdict(self.preparation)}

    def library(self) -> Library:
        """Return the library. Raises SceneError if it is missing or has other settings."""
        if not self.library_root.is_dir():
            raise SceneError(f"{self.library_root}: this library of objects is not prepared: {_COMMAND}")
        try:
            library = Library.load(self.library_root)
        except SceneError as error:
            raise SceneError(f"{error}: {_COMMAND}") from None
        if library.index.settings != self.settings():
            raise SceneError(f"{self.library_root}: this library was prepared with other settings: {_COMMAND}")
        return library

    def is_prepared(self) -> bool:
        """Return whether the library exists with these settings."""
        try:
            self.library()
        except SceneError:
            return False
        return True

    def libraries(self) -> tuple[LibraryObjects, ...]:
        return (self,)

    def account(self, configured: Mapping[str, Any]) -> dict[str, Any]:
        """Return the hash of the library, independent of its location, and the attribution of its objects."""
        library = self.library()
        attribution = {"attribution": library.index.attribution} if library.index.attribution else {}
        return {"library": library.hash} | attribution

    def sample(self, rng: np.random.Generator, target_faces: int, held_out: bool) -> tuple[Mesh, ...]:
        """Return a random object, decimated or refined to `target_faces` faces divided among its parts.

        An object that cannot be decimated that far, or not without holes, is replaced by the next draw.
        """
        library = self.library()
        objects = library.part(held_out)
        for _ in range(_ATTEMPTS):
            parts = library.parts(objects[int(rng.integers(len(objects)))])
            if (sized := _sized(parts, target_faces)) is not None:
                return sized
        raise SceneError(
            f"{self.library_root}: none of {_ATTEMPTS} objects can have {target_faces} faces: "
            "raise family.budget.per_object or add other meshes"
        )


def _sized(parts: tuple[Mesh, ...], target_faces: int) -> tuple[Mesh, ...] | None:
    """Decimate or refine the parts to their shares of the faces, or one face below; None if that is impossible."""
    try:
        shares = face_shares([len(part) for part in parts], target_faces)
        sized = [
            refined((closed_decimation if is_closed(part) else decimated)(part, share), share)
            for part, share in zip(parts, shares, strict=True)
        ]
    except SceneError:
        return None
    if any(share - len(part) > 1 for part, share in zip(sized, shares, strict=True)):
        return None
    return normalized_together(sized)
