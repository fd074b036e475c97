"""RenderFormer JSON v1.0, read and written."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from rfpp.errors import SceneError, one_line
from rfpp.files import as_file_name, write_atomically
from rfpp.scene.io.limits import (
    MAX_JSON_BYTES,
    MAX_PARTS,
    MAX_TRIANGLES,
    beside,
    parse_json,
    read_bytes,
    require_bounded,
)
from rfpp.scene.io.mesh_files import load_mesh, save_mesh
from rfpp.scene.mesh import Mesh, decimated
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Camera, Material, Scene, SceneObject, Strict, Transform

VERSION = "1.0"


class _SceneEntry(Strict):
    """The top level of the file."""

    scene_name: str = "scene"
    version: str
    objects: Annotated[dict[str, dict[str, Any]], Field(max_length=MAX_PARTS)]
    cameras: Annotated[tuple[dict[str, Any], ...], Field(max_length=MAX_PARTS)] = ()


class _ObjectEntry(Strict):
    """One value under `objects`."""

    mesh_path: Annotated[str, Field(min_length=1)]
    material: dict[str, Any]
    transform: dict[str, Any] = Field(default_factory=dict)
    remesh: bool = False
    remesh_target_face_num: Annotated[int, Field(ge=1)] = 2048


def load_json(path: Path) -> Scene:
    """Read a scene in RenderFormer JSON v1.0 with its meshes, whose paths are relative to the file.

    They lie in its folder or below: a scene names no file elsewhere. An object with `remesh` is reduced to at most
    `remesh_target_face_num` faces.

    Raises:
        SceneError: one line with the file, the key and the fix.
    """
    with _located(f"{path}"):
        entry = _SceneEntry(**parse_json(read_bytes(path, MAX_JSON_BYTES), "a scene in RenderFormer JSON v1.0"))
        if entry.version != VERSION:
            raise SceneError(f"version: '{one_line(entry.version)}' cannot be read, only '{VERSION}': convert the file")
        _require_printable(entry.scene_name)
        meshes = _Meshes()
        objects = tuple(_object(name, values, path.parent, meshes) for name, values in entry.objects.items())
        require_bounded(sum(len(item.mesh) for item in objects))
        return Scene(name=entry.scene_name, objects=objects, cameras=tuple(_cameras(entry.cameras)))


def save_json(scene: Scene | PackedScene, path: Path) -> Path:
    """Write RenderFormer JSON v1.0, and each different mesh as OBJ in the folder `<stem>_meshes` beside it.

    Returns:
        `path`.

    Raises:
        SceneError: an object whose material varies over its faces, or a packed scene: the format cannot say either.
        UserError: a file cannot be written.
    """
    if isinstance(scene, PackedScene):
        raise SceneError(f"{path}: scene '{scene.name}' is of triangles, JSON v1.0 of objects: save it as .h5")
    for item in scene.objects:
        if item.face_material is not None:
            raise SceneError(f"{path}: object '{item.name}': JSON v1.0 has one material an object: save it as .h5")
    mesh_paths = _save_meshes([item.mesh for item in scene.objects], [item.name for item in scene.objects], path)
    content = {
        "scene_name": scene.name,
        "version": VERSION,
        "objects": {
            item.name: {
                "mesh_path": mesh_path,
                "transform": item.transform.model_dump(),
                "material": item.material.model_dump(),
                "remesh": False,
            }
            for item, mesh_path in zip(scene.objects, mesh_paths, strict=True)
        },
        "cameras": [camera.model_dump() for camera in scene.cameras],
    }
    return write_atomically(path, (json.dumps(content, indent=2) + "\n").encode())


def _save_meshes(meshes: list[Mesh], names: list[str], scene_path: Path) -> list[str]:
    """The path of each mesh relative to the scene file; equal meshes share the file named after the first of them."""
    written: dict[tuple[bytes, bytes], str] = {}
    paths = []
    for mesh, name in zip(meshes, names, strict=True):
        content = (mesh.vertices.tobytes(), mesh.faces.tobytes())
        if content not in written:
            # The number keeps names apart that differ only in characters which file systems do not like.
            file_name = f"{len(written):02d}_{as_file_name(name)}.obj"
            written[content] = f"{scene_path.stem}_meshes/{file_name}"
            save_mesh(mesh, scene_path.parent / written[content])
        paths.append(written[content])
    return paths


class _Meshes:
    """The meshes of one scene: each file is read once, and reduced once for each number of faces."""

    def __init__(self) -> None:
        self._meshes: dict[tuple[Path, int | None], Mesh] = {}
        self._before = 0

    def get(self, path: Path, target_faces: int | None) -> Mesh:
        """The mesh, of at most so many faces. Raises SceneError: unreadable, or more to reduce than is reduced."""
        if (path, None) not in self._meshes:
            self._meshes[path, None] = load_mesh(path)
        mesh = self._meshes[path, None]
        if target_faces is None or len(mesh) <= target_faces:
            return mesh
        if (path, target_faces) not in self._meshes:
            self._before += len(mesh)
            if self._before > MAX_TRIANGLES:
                raise SceneError(f"meshes of more than {MAX_TRIANGLES:,} faces together are to be reduced: save them "
                                 "reduced, or give copies of one mesh the same remesh_target_face_num")  # fmt: skip
            self._meshes[path, target_faces] = decimated(mesh, target_faces)
        return self._meshes[path, target_faces]


def _object(name: str, values: dict[str, Any], folder: Path, meshes: _Meshes) -> SceneObject:
    with _located(f"object '{one_line(name)}'"):
        _require_printable(name)
        entry = _ObjectEntry(**values)
        return SceneObject(
            name=name,
            mesh=meshes.get(beside(folder, entry.mesh_path), entry.remesh_target_face_num if entry.remesh else None),
            material=Material(**entry.material),
            transform=Transform(**entry.transform),
        )


def _require_printable(name: str) -> None:
    """Names stand in messages and file names. Raises SceneError for line ends and half characters."""
    if not name.isprintable():
        raise SceneError(f"the name '{one_line(name)}' has characters that cannot be printed: rename it")


def _cameras(entries: tuple[dict[str, Any], ...]) -> Iterator[Camera]:
    for index, values in enumerate(entries):
        with _located(f"cameras.{index}"):
            yield Camera(**values)


@contextmanager
def _located(where: str) -> Iterator[None]:
    """Put `where` in front of the message of any SceneError raised inside."""
    try:
        yield
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from None
