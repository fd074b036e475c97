"""Read and write RenderFormer JSON v1.0."""

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
    """Top level of the file."""

    scene_name: str = "scene"
    version: str
    objects: Annotated[dict[str, dict[str, Any]], Field(max_length=MAX_PARTS)]
    cameras: Annotated[tuple[dict[str, Any], ...], Field(max_length=MAX_PARTS)] = ()


class _ObjectEntry(Strict):
    """Value under `objects`."""

    mesh_path: Annotated[str, Field(min_length=1)]
    material: dict[str, Any]
    transform: dict[str, Any] = Field(default_factory=dict)
    remesh: bool = False
    remesh_target_face_num: Annotated[int, Field(ge=1)] = 2048


def load_json(path: Path) -> Scene:
    """Read a scene in RenderFormer JSON v1.0 with its meshes, which lie in the file's folder or below.

    An object with `remesh` is decimated to at most `remesh_target_face_num` faces.

    Raises:
        SceneError: If the file is invalid; one line with the file, the key and the fix.
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
    """Write RenderFormer JSON v1.0, and each distinct mesh as OBJ in the folder `<stem>_meshes`; return the path.

    Raises:
        SceneError: If the scene is packed or a material varies over an object's faces.
        UserError: If a file cannot be written.
    """
    if isinstance(scene, PackedScene):
        raise SceneError(f"{path}: scene '{scene.name}' has no objects, which JSON v1.0 needs: save it as .h5")
    for item in scene.objects:
        if item.face_material is not None:
            raise SceneError(f"{path}: object '{item.name}': JSON v1.0 has one material per object: save it as .h5")
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
    """Write meshes; return their paths relative to the scene file. Equal meshes share a file."""
    written: dict[tuple[bytes, bytes], str] = {}
    paths = []
    for mesh, name in zip(meshes, names, strict=True):
        content = (mesh.vertices.tobytes(), mesh.faces.tobytes())
        if content not in written:
            # the number distinguishes names that differ only in replaced characters
            file_name = f"{len(written):02d}_{as_file_name(name)}.obj"
            written[content] = f"{scene_path.stem}_meshes/{file_name}"
            save_mesh(mesh, scene_path.parent / written[content])
        paths.append(written[content])
    return paths


class _Meshes:
    """The meshes of one scene: each file is read once, and decimated once for each number of faces."""

    def __init__(self) -> None:
        self._meshes: dict[tuple[Path, int | None], Mesh] = {}
        self._decimated_faces = 0

    def get(self, path: Path, target_faces: int | None) -> Mesh:
        """Return a mesh with at most `target_faces` faces. Raises SceneError if too many faces are to be decimated."""
        if (path, None) not in self._meshes:
            self._meshes[path, None] = load_mesh(path)
        mesh = self._meshes[path, None]
        if target_faces is None or len(mesh) <= target_faces:
            return mesh
        if (path, target_faces) not in self._meshes:
            self._decimated_faces += len(mesh)
            if self._decimated_faces > MAX_TRIANGLES:
                raise SceneError(f"meshes of more than {MAX_TRIANGLES:,} faces in total are to be decimated: save them "
                                 "decimated, or give copies of one mesh the same remesh_target_face_num")  # fmt: skip
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
            transform=Transform(**{"normalize": True, **entry.transform}),  # their default
        )


def _require_printable(name: str) -> None:
    """Raise SceneError for unprintable characters: names occur in messages and file names."""
    if not name.isprintable():
        raise SceneError(f"the name '{one_line(name)}' has characters that cannot be printed: rename it")


def _cameras(entries: tuple[dict[str, Any], ...]) -> Iterator[Camera]:
    for index, values in enumerate(entries):
        with _located(f"cameras.{index}"):
            yield Camera(**values)


@contextmanager
def _located(where: str) -> Iterator[None]:
    """Prepend `where` to the message of any SceneError raised inside."""
    try:
        yield
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from None
