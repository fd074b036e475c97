"""RenderFormer's H5 scenes: triangles, normals, texture patches and cameras, without objects."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rfpp.errors import SceneError
from rfpp.scene.packed import PackedScene
from rfpp.scene.texture import TEXTURE_CHANNELS, is_constant, mean_material
from rfpp.scene.triangles import SceneTriangles

#: Data set → shape; M triangles, P cells along a patch, V cameras.
_SHAPES = {
    "triangles": ("M", 3, 3),
    "vn": ("M", 3, 3),
    "texture": ("M", TEXTURE_CHANNELS, "P", "P"),
    "c2w": ("V", 4, 4),
    "fov": ("V",),
}


def load_h5(path: Path) -> PackedScene:
    """Read a scene in RenderFormer's H5 layout.

    The file names no objects: triangles of one material that touch at their corners become one. Constant texture
    patches are read as materials, varying ones are kept.

    Raises:
        SceneError: one line with the file, the data set and the fix.
    """
    try:
        with h5py.File(path) as file:
            arrays = {name: _array(file, name) for name in _SHAPES}
        _check(arrays)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read as HDF5 ({error}): correct the path or copy the file again") from None
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None

    texture = arrays["texture"]
    material = mean_material(texture)
    objects = _objects(arrays["triangles"], material)
    order = np.argsort(objects, kind="stable")
    counts = np.bincount(objects)
    triangles = SceneTriangles(
        positions=arrays["triangles"][order],
        normals=arrays["vn"][order],
        material=material[order],
        object_offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        object_names=tuple(f"part_{index}" for index in range(len(counts))),
    )
    varying = None if is_constant(texture) else texture[order].astype(np.float32)
    return PackedScene(path.stem, triangles, arrays["c2w"], arrays["fov"], varying)


def _array(file: h5py.File, name: str) -> np.ndarray:
    if name not in file or not isinstance(file[name], h5py.Dataset):
        raise SceneError(f"the data set '{name}' is missing: give a scene in RenderFormer's H5 layout")
    array = file[name][()]
    return array if name == "texture" else np.asarray(array, np.float32)


def _check(arrays: dict[str, np.ndarray]) -> None:
    sizes: dict[str, int] = {}
    for name, shape in _SHAPES.items():
        array = arrays[name]
        if name == "fov" and array.shape == (*array.shape[:1], 1):
            array = arrays[name] = array[:, 0]
        wanted = tuple(sizes.setdefault(n, size) if isinstance(n, str) else n for n, size in _paired(shape, array))
        if array.shape != wanted:
            raise SceneError(f"{name}: shape {array.shape} where {shape} with {sizes} was expected: convert it again")
        if not np.isfinite(array).all():
            raise SceneError(f"{name}: holds NaN or infinity: convert the scene again")
    if not sizes["M"]:
        raise SceneError("triangles: the scene is empty")


def _paired(shape: tuple, array: np.ndarray) -> list[tuple]:
    return [(n, array.shape[i] if i < array.ndim else -1) for i, n in enumerate(shape)]


def _objects(triangles: Float[np.ndarray, "m 3 3"], material: Float[np.ndarray, "m 10"]) -> Int[np.ndarray, " m"]:
    """The connected part of one material that each triangle belongs to, numbered in order of appearance."""
    count = len(triangles)
    _, of_material = np.unique(material, axis=0, return_inverse=True)
    corners = triangles.reshape(-1, 3)
    owner = np.repeat(np.arange(count), 3)
    _, vertex = np.unique(np.column_stack([corners, of_material.reshape(-1)[owner]]), axis=0, return_inverse=True)
    vertex = vertex.reshape(-1)
    links = coo_array((np.ones(len(owner), bool), (owner, count + vertex)), shape=(count + vertex.max() + 1,) * 2)
    _, part = connected_components(links, directed=False)
    _, first, numbered = np.unique(part[:count], return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[numbered.reshape(-1)]
