"""Objects from a folder tree of mesh files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rfpp.errors import SceneError
from rfpp.scene.io.mesh_files import MESH_SUFFIXES
from rfpp.scene.sampling.objects.library_objects import LibraryObjects, Original


@dataclass(frozen=True)
class FolderObjects(LibraryObjects):
    """Every OBJ, PLY, STL, glTF or GLB file in a folder tree is one object, named by its relative path.

    Attributes:
        folder: folder of the files; needed only for preparation. Its name is the library's name.
    """

    folder: str | None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.folder:
            raise SceneError("family.objects.folder is not given: add family.objects.folder=/my/meshes")

    @property
    def name(self) -> str:
        return self._path.name

    @property
    def _path(self) -> Path:
        return Path(self.folder).expanduser().absolute()

    def originals(self) -> list[Original]:
        """Return the files; a changed file is recognized by size and time."""
        if not self._path.is_dir():
            raise SceneError(f"{self._path}: there is no such folder: correct family.objects.folder")
        files = sorted(p for p in self._path.rglob("*") if p.suffix.lower() in MESH_SUFFIXES and p.is_file())
        if not files:
            raise SceneError(f"{self._path}: holds no mesh: give a folder of {', '.join(MESH_SUFFIXES)} files")
        stats = [path.stat() for path in files]
        return [
            Original(path.relative_to(self._path).as_posix(), f"{stat.st_size} {stat.st_mtime_ns}")
            for path, stat in zip(files, stats, strict=True)
        ]

    def fetched(self, originals: Iterable[Original]) -> Iterator[Original]:
        return (replace(original, path=self._path / original.id) for original in originals)

    def origin(self) -> dict[str, Any]:
        return {"folder": self.name}

    def is_prepared(self) -> bool:
        """Return whether the library exists and, if the folder does, holds the same files."""
        if not super().is_prepared():
            return False
        return not self._path.is_dir() or {original.id for original in self.originals()} == self.library().ids
