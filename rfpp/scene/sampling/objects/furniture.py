"""Objects from Sweet Home 3D furniture libraries (.sh3f): zip archives of models with a catalogue.

The format: https://www.sweethome3d.com/documentation.jsp, "Furniture library files".
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

from rfpp.errors import SceneError
from rfpp.scene.io.limits import MAX_ENTRIES, read_member
from rfpp.scene.io.mesh_files import MESH_SUFFIXES
from rfpp.scene.sampling.objects.library_objects import LibraryObjects, Original

_CATALOGUE = "PluginFurnitureCatalog.properties"
_MAX_CATALOGUE_BYTES = 2**24


@dataclass(frozen=True)
class Catalogue:
    """The catalogue of one archive.

    Attributes:
        attribution: name, license, creators and provider, as stated in the catalogue.
        models: id of the piece of furniture → name of its model's file in the archive.
    """

    sha256: str
    attribution: dict[str, Any]
    models: dict[str, str]

    @classmethod
    def read(cls, path: Path) -> Catalogue:
        """Read the catalogue of an archive. Raises SceneError naming the archive."""
        values = _properties(read_member(path, _CATALOGUE, _MAX_CATALOGUE_BYTES).decode("latin-1"))
        numbers = sorted(key.partition("#")[2] for key in values if key.startswith("model#"))
        if not numbers:
            raise SceneError(f"{path}: its catalogue names no model: give a library of furniture")
        if len(numbers) > MAX_ENTRIES:
            raise SceneError(f"{path}: its catalogue names {len(numbers):,} models, the limit is {MAX_ENTRIES:,}")
        files = {number: values[f"model#{number}"].lstrip("/") for number in numbers}
        with path.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        attribution = {
            "name": values.get("name", path.stem),
            "license": values.get("license", ""),
            "creators": sorted({values[key] for n in numbers if (key := f"creator#{n}") in values}),
            "provider": values.get("provider", ""),
            "sha256": sha256,
        }
        return cls(sha256, attribution, {values.get(f"id#{n}", PurePosixPath(f).stem): f for n, f in files.items()})


@dataclass(frozen=True)
class FurnitureObjects(LibraryObjects):
    """Each piece of furniture in some .sh3f files is one object, named by its file and its id in the catalogue."""

    library_name: str
    folder: str
    files: Sequence[str]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.files:
            raise SceneError("family.objects.files is empty: name the .sh3f files to take objects from")

    @property
    def name(self) -> str:
        return self.library_name

    def originals(self) -> list[Original]:
        """Return the models of each file, by id."""
        return [
            Original(f"{file}/{item}", catalogue.sha256, self._path(file), member)
            for file, catalogue in self._catalogues().items()
            for item, member in sorted(catalogue.models.items())
            if Path(member).suffix.lower() in MESH_SUFFIXES
        ]

    def origin(self) -> dict[str, Any]:
        return {"furniture": list(self.files)}

    def attribution(self) -> dict[str, Any]:
        return {file: catalogue.attribution for file, catalogue in self._catalogues().items()}

    def _catalogues(self) -> dict[str, Catalogue]:
        paths = {file: self._path(file) for file in self.files}
        if missing := [path for path in paths.values() if not path.exists()]:
            raise SceneError(
                f"{missing[0]}: there is no such file: unpack Debian's sweethome3d-furniture as in data/README.md, or "
                "set family.objects.folder"
            )
        return {file: _catalogue(path, path.stat().st_mtime_ns) for file, path in paths.items()}

    def _path(self, file: str) -> Path:
        return Path(self.folder).expanduser().absolute() / f"{file}.sh3f"


@lru_cache(maxsize=16)  # hashing reads a hundred megabytes
def _catalogue(path: Path, _modified: int) -> Catalogue:
    return Catalogue.read(path)


def _properties(text: str) -> dict[str, str]:
    """Parse `key=value` lines of a Java properties file, without continued lines and escapes."""
    pairs = (line.split("=", 1) for line in text.splitlines() if "=" in line and not line.startswith(("#", "!")))
    return {key.strip(): value.strip() for key, value in pairs}
