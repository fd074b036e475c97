"""Any scene file: which reader it needs, and what becomes of a scene that was not made for this project.

RenderFormer's JSON and H5 are taken as they are. Everything else is `fitted`.
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
from rfpp.scene.io.obj import read_obj
from rfpp.scene.io.ply import read_ply
from rfpp.scene.io.renderformer_json import load_json
from rfpp.scene.io.stl import read_stl
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Scene

#: Suffix → reader, and the axis that points up in the file; None where the reader turns it.
_READERS: dict[str, tuple[Callable[[Path], ImportedScene], str | None]] = {
    ".gltf": (read_gltf, None),
    ".glb": (read_gltf, None),
    ".obj": (read_obj, "y"),
    ".ply": (read_ply, "z"),
    ".stl": (read_stl, "z"),
}
_H5_SUFFIXES = (".h5", ".hdf5")
#: What other programs write, none of which is opened; several are XML or archives.
_FOREIGN = (".3ds", ".3mf", ".abc", ".blend", ".dae", ".fbx", ".ma", ".max", ".off", ".svg", ".usd", ".usda", ".usdc",
            ".usdz", ".vrml", ".wrl", ".x3d", ".xml", ".zip")  # fmt: skip
_MAX_FILES = 1000
_MANY_TRIANGLES = 80_000  # the most that a training scene has


def load_scene(
    path: str | Path,
    *,
    triangles: int | None = None,
    up: str | None = None,
    transparent: Transparent = "opaque",
    backdrop: Backdrop = "floor",
) -> Scene | PackedScene:
    """Read any scene.

    RenderFormer JSON v1.0 as it is, and its H5, which holds no objects and comes packed; glTF (.gltf, .glb), OBJ with
    MTL, PLY, STL, or a folder of these, whose surfaces are fitted into [-0.5, 0.5]^3, with a camera and lights where
    there are none. Each change is a warning of one line. `rfpp.scene.io` says how nodes, materials, lights and textures
    are read.

    Args:
        triangles: a scene of more is decimated to so many.
        up: the axis that points up in OBJ (else y), PLY and STL files (else z); glTF says y.
        transparent: what becomes of surfaces that light should pass through, which nothing here does.
        backdrop: what a foreign scene without camera, light and floor is put on: floor, corner (with two walls), none.

    Raises:
        SceneError: naming the file, what is wrong or cannot be represented, and the fix.
    """
    path = Path(path)
    if triangles is not None and triangles < 1:
        raise SceneError(f"triangles={triangles}: give at least 1")
    if up not in (None, "y", "z"):
        raise SceneError(f"up={up}: choose y or z")
    if transparent not in ("opaque", "drop", "refuse"):
        raise SceneError(f"transparent={transparent}: choose opaque, drop or refuse")
    if backdrop not in ("floor", "corner", "none"):
        raise SceneError(f"backdrop={backdrop}: choose floor, corner or none")
    suffix = path.suffix.lower()
    if path.is_dir() or suffix in _READERS:
        scene = _imported(path, up, transparent, backdrop)
        total = sum(len(item.mesh) for item in scene.objects)
        if triangles is None and total > _MANY_TRIANGLES:
            warnings.warn(
                f"{path}: {total:,} triangles, where training scenes have {_MANY_TRIANGLES:,} at most: "
                f"triangles={_MANY_TRIANGLES} reduces them",
                stacklevel=2,
            )
    elif suffix in _H5_SUFFIXES:
        if triangles is not None:
            raise SceneError(f"{path}: triangles={triangles}: H5 scenes are not decimated: leave it away")
        from rfpp.scene.io.renderformer_h5 import load_h5  # late: its library is an extra

        return load_h5(path)
    elif suffix in _FOREIGN:
        raise SceneError(f"{path}: {suffix} cannot be read: open it in Blender and export glTF (.glb)")
    elif suffix not in (".json", ""):
        known = ", ".join((".json", *_H5_SUFFIXES, *_READERS))
        raise SceneError(f"{path}: '{suffix}' is no scene that can be read: give {known} or a folder of meshes")
    else:
        scene = load_json(path)
    try:
        for item in scene.objects:
            _ = item.world_mesh  # raises here, where the file is known; packing uses the cached mesh
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    return scene if triangles is None else within_budget(scene, triangles, f"{path}")


def _imported(path: Path, up: str | None, transparent: Transparent, backdrop: Backdrop) -> Scene:
    try:
        return fitted(_folder(path, up) if path.is_dir() else _file(path, up), path, transparent, backdrop).scene
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None


def _file(path: Path, up: str | None) -> ImportedScene:
    reader, usual = _READERS[path.suffix.lower()]
    with np.errstate(over="ignore", invalid="ignore"):
        scene = reader(path)
        return scene if usual is None or (up or usual) == "z" else _turned(scene)


def _folder(folder: Path, up: str | None) -> ImportedScene:
    """Every mesh file in a folder, in one common space."""
    try:
        files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _READERS)
    except OSError as error:
        raise SceneError(f"cannot be read ({error.strerror}): check its permissions") from None
    if not files:
        raise SceneError(f"holds no mesh: give a folder of {', '.join(_READERS)} files, or a scene file")
    if len(files) > _MAX_FILES:
        raise SceneError(f"holds {len(files):,} meshes, of which a scene takes {_MAX_FILES:,}: give fewer")
    scenes = []
    for path in files:
        try:
            scenes.append(_file(path, up))
        except SceneError as error:
            raise SceneError(f"{path.name}: {error}") from None
        require_bounded(sum(len(part) for scene in scenes for part in scene.parts))
    return ImportedScene.joined(folder.name, scenes)


def _turned(scene: ImportedScene) -> ImportedScene:
    """Y up made Z up. Only files without lamps and cameras do not say which axis it is."""
    return replace(scene, parts=tuple(replace(part, vertices=z_up(part.vertices)) for part in scene.parts))
