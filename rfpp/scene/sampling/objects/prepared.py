"""Object sources that need preparation before sampling."""

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
from rfpp.scene.io.limits import MAX_TEXT_BYTES
from rfpp.scene.mesh import Mesh, decimated, normalized_together
from rfpp.scene.sampling.objects.archive import read_member
from rfpp.scene.sampling.objects.library import Library, Prepared
from rfpp.scene.sampling.objects.material_groups import face_shares
from rfpp.scene.sampling.objects.preparation import Preparation
from rfpp.scene.sampling.objects.refinement import is_closed, refined
from rfpp.scene.sampling.objects.solid import closed_decimation

#: Objects drawn for one place in a scene before the request counts as impossible.
_ATTEMPTS = 100


class TooFewFacesError(SceneError):
    """An object cannot be reduced to so few faces, or not without holes."""


@dataclass(frozen=True)
class Original:
    """A foreign mesh.

    Attributes:
        id: names it in the library, on every machine.
        stamp: another one after the mesh has changed.
        path: its file, or the zip archive that holds it; None if it could not be had.
        member: its name in the archive.
    """

    id: str
    stamp: str
    path: Path | None = None
    member: str | None = None

    @contextmanager
    def file(self) -> Iterator[Path]:
        """The mesh's file, while the context is open. Raises SceneError where an archive does not give it."""
        if self.member is None:
            yield self.path
            return
        with TemporaryDirectory() as folder:
            path = Path(folder) / f"mesh{Path(self.member).suffix.lower()}"
            path.write_bytes(read_member(self.path, self.member, MAX_TEXT_BYTES))
            yield path


@dataclass(frozen=True)
class PreparedObjects(ABC):
    """Objects of a library that `rfpp.scene.sampling.objects.library_building.prepare` makes.

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

    def attribution(self) -> dict[str, Any]:
        """Who made the originals and on what terms they may be used, as JSON; empty where that is not known."""
        return {}

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

    def libraries(self) -> tuple[PreparedObjects, ...]:
        """This one."""
        return (self,)

    def account(self, configured: Mapping[str, Any]) -> dict[str, Any]:
        """The hash of the library, not where it came from, and whom its objects are owed to where it says so."""
        library = self.library()
        owed = {"attribution": library.index.attribution} if library.index.attribution else {}
        return {"library": library.hash} | owed

    def sample(self, rng: np.random.Generator, target_faces: int, held_out: bool) -> tuple[Mesh, ...]:
        """A random object of the library, decimated or refined to `target_faces` faces or one below.

        The faces are shared out among its parts in proportion to what they have. An object that cannot be reduced
        so far, or not without holes, gives way to the next draw.
        """
        library = self.library()
        objects = library.part(held_out)
        for _ in range(_ATTEMPTS):
            try:
                return self.sized(library, objects[int(rng.integers(len(objects)))], target_faces)
            except TooFewFacesError:
                continue
        raise SceneError(
            f"{self.library_root}: none of {_ATTEMPTS} objects can have {target_faces} faces: "
            "raise family.budget.per_object or bring other meshes"
        )

    def sized(self, library: Library, item: Prepared, target_faces: int) -> tuple[Mesh, ...]:
        """The object in its parts, decimated or refined to `target_faces` faces or one below for each.

        Raises:
            TooFewFacesError: that cannot be had of it.
            SceneError: its file is missing or damaged.
        """
        parts = library.parts(item)
        try:
            shares = [target_faces] if len(parts) == 1 else face_shares([len(part) for part in parts], target_faces)
            sized = [_with_faces(part, share) for part, share in zip(parts, shares, strict=True)]
        except SceneError as error:
            raise TooFewFacesError(f"{library.root}: {item.id}: {error}") from None
        if any(share - len(part) > 1 for part, share in zip(sized, shares, strict=True)):
            raise TooFewFacesError(f"{library.root}: {item.id} cannot have {target_faces} faces: ask for more")
        return normalized_together(sized)


def _with_faces(part: Mesh, faces: int) -> Mesh:
    """With so many faces, or fewer where it cannot be refined so far. Raises SceneError if so few cannot be had."""
    return refined((closed_decimation if is_closed(part) else decimated)(part, faces), faces)
