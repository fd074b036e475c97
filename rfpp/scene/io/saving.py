"""Save scenes in formats that `rfpp.scene.io.loading` reads back exactly."""

from __future__ import annotations

from pathlib import Path

from rfpp.scene.io.renderformer_json import save_json
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.spec import Scene


def fits_json(scene: Scene | PackedScene) -> bool:
    """Return whether JSON can hold a scene: it has objects, each of one material."""
    return isinstance(scene, Scene) and all(item.face_material is None for item in scene.objects)


def save_scene(scene: Scene | PackedScene, path: str | Path) -> Path:
    """Write RenderFormer JSON v1.0 with the meshes as OBJ files beside it, or its H5 (.h5); return the path.

    Raises SceneError for JSON of a scene that only H5 can hold, see `fits_json`.
    """
    path = Path(path)
    if path.suffix not in (".h5", ".hdf5"):
        return save_json(scene, path)
    from rfpp.scene.io.renderformer_h5 import save_h5  # needs an optional dependency

    return save_h5(pack(scene), path)
