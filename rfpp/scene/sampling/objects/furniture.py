"""Objects from Sweet Home 3D furniture libraries."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from rfpp.errors import SceneError
from rfpp.scene.io.mesh_files import MESH_SUFFIXES
from rfpp.scene.sampling.objects.archive import Furniture
from rfpp.scene.sampling.objects.prepared import Original, PreparedObjects


@dataclass(frozen=True)
class FurnitureObjects(PreparedObjects):
    """Each piece of furniture in some .sh3f files is one object, called by its file and its id in the catalogue.

    Attributes:
        library_name: of what is made of them.
        folder: where the files are; after preparation they are not needed any more.
        files: their names there, without the suffix.
    """

    library_name: str
    folder: str
    files: Sequence[str]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.files:
            raise SceneError("family.objects.files is empty: name the .sh3f files to take objects from")
        object.__setattr__(self, "files", tuple(self.files))

    @property
    def name(self) -> str:
        return self.library_name

    def originals(self) -> list[Original]:
        """Of each file in turn, its models by their ids."""
        return [
            Original(f"{file}/{item}", sha256, self._path(file), member)
            for file in self.files
            for catalogue, sha256 in [self._catalogue(file)]
            for item, member in sorted(catalogue.models.items())
            if Path(member).suffix.lower() in MESH_SUFFIXES
        ]

    def fetched(self, originals: Iterable[Original]) -> Iterator[Original]:
        return iter(originals)

    def origin(self) -> dict[str, Any]:
        return {"furniture": list(self.files)}

    def attribution(self) -> dict[str, Any]:
        """Names, licences and creators by file, for all who show what was made of the models."""
        return {
            file: {
                "name": catalogue.name,
                "license": catalogue.license,
                "creators": list(catalogue.creators),
                "provider": catalogue.provider,
                "sha256": sha256,
            }
            for file in self.files
            for catalogue, sha256 in [self._catalogue(file)]
        }

    def _catalogue(self, file: str) -> tuple[Furniture, str]:
        path = self._path(file)
        try:
            return _read(path, path.stat().st_mtime_ns)
        except OSError:
            raise SceneError(
                f"{path}: there is no such file: install Debian's sweethome3d-furniture (`apt-get download "
                "sweethome3d-furniture` and `dpkg -x` need no root) and give family.objects.folder=<where it is>"
            ) from None

    def _path(self, file: str) -> Path:
        return Path(self.folder).expanduser().absolute() / f"{file}.sh3f"


@lru_cache(maxsize=16)  # a hundred megabytes to hash
def _read(path: Path, _changed: int) -> tuple[Furniture, str]:
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return Furniture.read(path), sha256
