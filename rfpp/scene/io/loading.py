"""Load any scene file.

RenderFormer's JSON and H5 are loaded unchanged. All other formats are `fitted`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from rfpp.errors import SceneError
from rfpp.scene.budget import within_budget
from rfpp.scene.io.backdrop import Backdrop
from rfpp.scene.io.fitting import Transparent, fitted
from rfpp.scene.io.gltf import read_gltf
from rfpp.scene.io.imported_scene import ImportedScene, z_up
from rfpp.scene.io.limits import require_bounded
from rfpp.scene.io.mesh_scenes import read_obj, read_ply, read_stl
from rfpp.scene.io.renderformer_json import load_json
from rfpp.scene.io.texture_detail import TEXTURE_TRIANGLES
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Scene

#: Suffix → reader and the file's up axis; None if the reader converts it.
_READERS: dict[str, tuple[Callable[..., ImportedScene], str | None]] = {
    ".gltf": (read_gltf, None),
    ".glb": (read_gltf, None),
    ".obj": (read_obj, "y"),
    ".ply": (read_ply, "z"),
    ".stl": (read_stl, "z"),
}
_TEXTURED = (".gltf", ".glb", ".obj")
_H5_SUFFIXES = (".h5", ".hdf5")
#: Formats of other programs, never opened; several are XML or archives.
_FOREIGN = (".3ds", ".3mf", ".abc", ".blend", ".dae", ".fbx", ".ma", ".max", ".off", ".svg", ".usd", ".usda", ".usdc",
            ".usdz", ".vrml", ".wrl", ".x3d", ".xml", ".zip")  # fmt: skip
_CHOICES = {
    "up": (None, "y", "z"),
    "transparent": ("opaque", "drop", "refuse"),
    "backdrop": ("floor", "corner", "none"),
}
_MAX_FILES = 1000
#: A scene, or its file.
AnyScene = Scene | PackedScene | Path | str
_MANY_TRIANGLES = 80_000  # maximum of training scenes


def load_scene(
    path: str | Path,
    *,
    triangles: int | None = None,
    up: str | None = None,
    transparent: Transparent = "opaque",
    backdrop: Backdrop = "floor",
    detail: int = TEXTURE_TRIANGLES,
) -> Scene | PackedScene:
    """Load a scene.

    Reads RenderFormer JSON v1.0 and H5 (which holds no objects and is returned packed) unchanged. The surfaces of glTF
    (.gltf, .glb), OBJ with MTL, PLY, STL, or a folder of these are fitted into [-0.5, 0.5]^3; a missing camera and
    missing lights are added. Each change is a one-line warning.

    Args:
        path: Scene file or folder of meshes.
        triangles: Maximum number of triangles; larger scenes are decimated.
        up: Up axis of OBJ (default y), PLY and STL files (default z); glTF is always y.
        transparent: Treatment of transparent surfaces, which cannot be represented.
        detail: Number of triangles that may be added where textures vary. Cameras see textures as they are; networks
            and light between surfaces take one color per triangle.
        backdrop: Surroundings of a foreign scene without camera, light and floor: floor, corner (with two walls), none.

    Raises:
        SceneError: If the file cannot be read or represented; names the file, the problem and the fix.
    """
    path = Path(path)
    if triangles is not None and triangles < 1:
        raise SceneError(f"triangles={triangles}: give at least 1")
    for name, value in (("up", up), ("transparent", transparent), ("backdrop", backdrop)):
        if value not in _CHOICES[name]:
            known = [choice for choice in _CHOICES[name] if choice]
            raise SceneError(f"{name}={value}: choose {', '.join(known[:-1])} or {known[-1]}")
    suffix = path.suffix.lower()
    if path.is_dir() or suffix in _READERS:
        scene = _imported(path, up, transparent, backdrop, (detail, triangles))
        total = sum(len(item.mesh) for item in scene.objects)
        if triangles is None and total > _MANY_TRIANGLES:
            warnings.warn(
                f"{path}: {total:,} triangles, more than the {_MANY_TRIANGLES:,} of training scenes: "
                f"triangles={_MANY_TRIANGLES} reduces them",
                stacklevel=2,
            )
    elif suffix in _H5_SUFFIXES:
        if triangles is not None:
            raise SceneError(f"{path}: triangles={triangles}: H5 scenes are not decimated: omit it")
        from rfpp.scene.io.renderformer_h5 import load_h5  # needs an optional dependency

        return load_h5(path)
    elif suffix in _FOREIGN:
        raise SceneError(f"{path}: {suffix} cannot be read: open it in Blender and export glTF (.glb)")
    elif suffix not in (".json", ""):
        known = ", ".join((".json", *_H5_SUFFIXES, *_READERS))
        raise SceneError(f"{path}: unsupported scene format '{suffix}': give {known} or a folder of meshes")
    else:
        scene = load_json(path)
    try:
        for item in scene.objects:
            _ = item.world_mesh  # raises here, where the file is known; packing uses the cached mesh
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    return scene if triangles is None else within_budget(scene, triangles, f"{path}")


def packed_scene(scene: AnyScene) -> PackedScene:
    """Return the triangles and cameras of a scene or a scene file. Raises SceneError like `load_scene`."""
    return pack(load_scene(scene) if isinstance(scene, Path | str) else scene)


def _imported(
    path: Path, up: str | None, transparent: Transparent, backdrop: Backdrop, detail: tuple[int, int | None]
) -> Scene:
    try:
        imported = _folder(path, up, detail) if path.is_dir() else _file(path, up, detail)
        return fitted(imported, path, transparent, backdrop).scene
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None


def _file(path: Path, up: str | None, detail: tuple[int, int | None]) -> ImportedScene:
    reader, default_up = _READERS[path.suffix.lower()]
    with np.errstate(over="ignore", invalid="ignore"):
        scene = reader(path, *detail) if path.suffix.lower() in _TEXTURED else reader(path)
        if default_up is None or (up or default_up) == "z":
            return scene
        # only files without lights and cameras leave the up axis open
        return replace(scene, parts=tuple(replace(part, vertices=z_up(part.vertices)) for part in scene.parts))


def _folder(folder: Path, up: str | None, detail: tuple[int, int | None]) -> ImportedScene:
    try:
        files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _READERS)
    except OSError as error:
        raise SceneError(f"cannot be read ({error.strerror}): check its permissions") from None
    if not files:
        raise SceneError(f"holds no mesh: give a folder of {', '.join(_READERS)} files, or a scene file")
    if len(files) > _MAX_FILES:
        raise SceneError(f"holds {len(files):,} meshes, the limit is {_MAX_FILES:,}: give fewer")
    scenes = []
    for path in files:
        try:
            scenes.append(_file(path, up, detail))
        except SceneError as error:
            raise SceneError(f"{path.name}: {error}") from None
        require_bounded(sum(len(part) for scene in scenes for part in scene.parts))
    return ImportedScene.joined(folder.name, scenes)
