"""RenderFormer's H5 scenes: triangles, normals, texture patches, cameras and optional images, without objects.

The additions to its inference format follow RenderFormer's training tools (`src/renderformer/data` of
iamNCJ/RenderFormer-Studio, `exporters/v1.py` and `loaders/common.py`): `img` [V, H, W, 3 or 4] half, linear radiance,
channels last, of which training uses three; `mvp` [V, 4, 4], the OpenGL projection (near plane 0.05, far plane 5, y
down) times world-to-camera, unused in training. `fov` is in degrees.

`save_h5` adds `object_index` [M] int32, the object of each triangle.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from rfpp.errors import SceneError, one_line
from rfpp.files import write_atomically
from rfpp.scene.io.limits import MAX_ENTRIES, require_bounded
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import FARTHEST
from rfpp.scene.texture import (
    FLAT_NORMAL,
    MATERIAL_CHANNELS,
    NORMAL_CHANNELS,
    TEXTURE_CHANNELS,
    covered_cells,
    is_constant,
    mean_material,
)
from rfpp.scene.triangles import SceneTriangles

#: Data set → shape; M triangles, P cells along a patch, V cameras.
_SHAPES = {
    "triangles": ("M", 3, 3),
    "vn": ("M", 3, 3),
    "texture": ("M", TEXTURE_CHANNELS, "P", "P"),
    "c2w": ("V", 4, 4),
    "fov": ("V",),
}
_IMAGES, _OBJECTS = "img", "object_index"

_PATCH = 32  # cells along a written patch, as in released checkpoints
_CHUNK = (1024, 2, 4, 8)  # compression chunks: 75 bytes per triangle instead of 200
_COMPRESSION = {"compression": "gzip", "compression_opts": 9, "shuffle": True}
_SLAB = 1024  # patches in memory at a time: 27 MB
_NEAR, _FAR = 0.05, 5.0
_MAX_PATCH = 128
_LEAST_RIGHT = 0.01  # tolerance of scalar products of a camera's axes
_MOST_COMPRESSED = 1100  # limit of deflate's compression ratio


def load_h5(path: Path) -> PackedScene:
    """Read a scene in RenderFormer's H5 layout.

    Without stored objects, connected triangles of one material become an object. Constant texture patches are read as
    materials; varying ones are kept.

    Raises:
        SceneError: If the file is invalid; one line with the file, the data set and the fix.
    """
    with _opened(path) as file:
        _check_shapes(file)
        arrays = {name: _finite(name, file[name][()]) for name in _SHAPES if name != "texture"}
        _require_cameras(arrays["c2w"], arrays["fov"])
        material, texture = _material(file["texture"])
        objects = _stored_objects(file) if _OBJECTS in file else _connected(arrays["triangles"], material)

    order = np.argsort(objects, kind="stable")
    counts = np.bincount(objects)
    triangles = SceneTriangles(
        positions=arrays["triangles"][order],
        normals=arrays["vn"][order],
        material=material[order],
        object_offsets=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        object_names=tuple(f"part_{index}" for index in range(len(counts))),
    )
    varying = None if texture is None else texture[order].astype(np.float32)
    return PackedScene(path.stem, triangles, arrays["c2w"], arrays["fov"].reshape(-1), varying)


def image_shape(path: Path) -> tuple[int, int, int]:
    """Return views, height and width of the reference images without reading them. Raises like `load_images`."""
    with _opened(path) as file:
        return _images(file).shape[:3]


def load_images(path: Path) -> Float[np.ndarray, "v h w 3"]:
    """Read the reference images, linear radiance. Raises SceneError if they are missing or damaged."""
    with _opened(path) as file:
        return _finite(_IMAGES, _images(file)[..., :3]).astype(np.float32)


def save_h5(scene: PackedScene, path: Path, images: Float[np.ndarray, "v h w 3"] | None = None) -> Path:
    """Write a scene in RenderFormer's H5 layout with materials in half precision; return the path.

    Args:
        images: Linear radiance for each camera, stored in half precision.

    Raises:
        SceneError: If an emission or a radiance exceeds half precision.
        UserError: If the file cannot be written.
    """
    triangles = scene.triangles
    arrays = {"triangles": triangles.positions, "vn": triangles.normals, "c2w": scene.c2w, "fov": scene.fov}
    arrays = {name: array.astype(np.float32) for name, array in arrays.items()} | {_OBJECTS: triangles.object_index}
    if images is not None:
        arrays[_IMAGES] = _half(images, f"{path}: {_IMAGES}")
        arrays["mvp"] = _projections(scene, *images.shape[1:3])
    values = _half(triangles.material if scene.texture is None else scene.texture, f"{path}: material")
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array, **_COMPRESSION)
        shape = (len(values), TEXTURE_CHANNELS, *(values.shape[2:] or (_PATCH, _PATCH)))
        texture = file.create_dataset(
            "texture", shape, np.float16, chunks=tuple(map(min, _CHUNK, shape)), **_COMPRESSION
        )
        for rows in _slabs(texture):
            texture[rows] = _patches(values[rows]) if scene.texture is None else values[rows]
    return write_atomically(path, content.getvalue())


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open the file and prepend its name to any SceneError raised inside."""
    try:
        if path.exists() and not path.is_file():
            raise SceneError("is not a regular file: correct the path")
        with h5py.File(path) as file:
            yield file
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as error:  # h5py's errors for damaged files
        reason = one_line(str(error))
        raise SceneError(
            f"{path}: cannot be read as HDF5 ({reason}): correct the path or copy the file again"
        ) from None


def _dataset(file: h5py.File, name: str, fix: str) -> h5py.Dataset:
    """Return a numeric data set stored in this file and no larger than its size allows."""
    link = file.get(name, getlink=True)  # unresolved, because its target may block
    if link is not None and not isinstance(link, h5py.HardLink):
        raise SceneError(f"{name}: its content lies in another file: copy it into this one")
    if link is None or not isinstance(file[name], h5py.Dataset):
        raise SceneError(f"the data set '{name}' is missing: {fix}")
    dataset = file[name]
    if dataset.external or dataset.is_virtual:
        raise SceneError(f"{name}: its content lies in another file: copy it into this one")
    if dataset.dtype.kind not in "fiu" or dataset.ndim == 0:
        raise SceneError(f"{name}: {dataset.dtype} where an array of numbers was expected: convert the scene again")
    if dataset.nbytes > _MOST_COMPRESSED * dataset.id.get_storage_size():
        raise SceneError(f"{name}: claims {dataset.nbytes:,} bytes, more than it holds: convert the scene again")
    return dataset


def _check_shapes(file: h5py.File) -> None:
    sizes: dict[str, int] = {}
    for name, shape in _SHAPES.items():
        found = _dataset(file, name, "give a scene in RenderFormer's H5 layout").shape
        if name == "fov" and found[1:] == (1,):
            found = found[:1]
        known = [(n, found[i] if i < len(found) else -1) for i, n in enumerate(shape)]
        wanted = tuple(sizes.setdefault(n, size) if isinstance(n, str) else n for n, size in known)
        if found != wanted:
            raise SceneError(f"{name}: shape {found} where {shape} with {sizes} was expected: convert it again")
    if not sizes["M"]:
        raise SceneError("triangles: the scene is empty")
    require_bounded(sizes["M"])
    if sizes["V"] > MAX_ENTRIES:
        raise SceneError(f"c2w: {sizes['V']:,} cameras, the limit is {MAX_ENTRIES:,}")
    if not 1 <= sizes["P"] <= _MAX_PATCH:
        raise SceneError(f"texture: patches of {sizes['P']} cells a side: give 1 to {_MAX_PATCH}")


def _require_cameras(c2w: Float[np.ndarray, "v 4 4"], fov: np.ndarray) -> None:
    if not ((fov > 0) & (fov < 180)).all():
        raise SceneError("fov: not between 0 and 180 degrees: convert the scene again")
    axes = c2w[:, :3, :3].astype(np.float64)
    if (
        np.abs(axes @ axes.swapaxes(1, 2) - np.eye(3)).max(initial=0) > _LEAST_RIGHT
        or np.abs(c2w).max(initial=0) > FARTHEST
    ):
        raise SceneError("c2w: not a camera pose (three orthogonal unit axes and a position): convert the scene again")


def _finite(name: str, array: np.ndarray) -> np.ndarray:
    """Return the array as float32, or unchanged in half precision; raise SceneError if it is not finite."""
    if array.dtype != np.float16:
        with np.errstate(over="ignore"):  # infinite values are refused below
            array = array.astype(np.float32)
    if not np.isfinite(array).all():
        raise SceneError(f"{name}: holds NaN or infinity: convert the scene again")
    return array


def _images(file: h5py.File) -> h5py.Dataset:
    images = _dataset(file, _IMAGES, "give training data, whose files hold the reference images")
    views = len(_dataset(file, "c2w", "give a scene in RenderFormer's H5 layout"))
    if images.ndim != 4 or images.shape[0] != views or images.shape[3] not in (3, 4):
        raise SceneError(f"{_IMAGES}: shape {images.shape} where ({views}, height, width, 3 or 4) was expected")
    return images


def _material(texture: h5py.Dataset) -> tuple[Float[np.ndarray, "m 10"], Float[np.ndarray, "m 13 p p"] | None]:
    """Return a material per triangle, and the patches if any varies, reading them piecewise."""
    materials, constant = [], True
    for rows in _slabs(texture):
        patches = _finite("texture", texture[rows])
        materials.append(mean_material(patches))
        constant = constant and is_constant(patches)
    return np.concatenate(materials), None if constant else texture[()]


def _slabs(texture: h5py.Dataset) -> Iterator[slice]:
    """Yield ranges of whole chunks, so that none is decompressed twice."""
    chunk = texture.chunks[0] if texture.chunks else 1
    step = max(1, _SLAB // chunk) * chunk
    return (slice(start, start + step) for start in range(0, len(texture), step))


def _patches(material: Float[np.ndarray, "m 10"]) -> Float[np.ndarray, "m 13 p p"]:
    values = np.empty((len(material), TEXTURE_CHANNELS), material.dtype)
    values[:, MATERIAL_CHANNELS], values[:, NORMAL_CHANNELS] = material, FLAT_NORMAL
    return values[:, :, None, None] * covered_cells(_PATCH).astype(material.dtype)


def _half(array: np.ndarray, what: str) -> np.ndarray:
    largest = np.abs(array).max(initial=0)
    if not largest <= np.finfo(np.float16).max:
        raise SceneError(f"{what}: {largest:.6g} cannot be stored in half precision: lower the emission")
    return array.astype(np.float16)


def _projections(scene: PackedScene, height: int, width: int) -> Float[np.ndarray, "v 4 4"]:
    """Return `mvp`: world to OpenGL clip space."""
    longest = max(height, width)
    projections = np.zeros((len(scene.fov), 4, 4))
    focal = 1 / np.tan(np.radians(scene.fov.astype(np.float64)) / 2)
    projections[:, 0, 0], projections[:, 1, 1] = focal * longest / width, -focal * longest / height
    projections[:, 2, 2:] = -(_FAR + _NEAR) / (_FAR - _NEAR), -2 * _FAR * _NEAR / (_FAR - _NEAR)
    projections[:, 3, 2] = -1
    return (projections @ np.linalg.inv(scene.c2w.astype(np.float64))).astype(np.float32)


def _stored_objects(file: h5py.File) -> Int[np.ndarray, " m"]:
    index = _dataset(file, _OBJECTS, "convert the scene again")[()]
    if index.shape != file["triangles"].shape[:1] or index.dtype.kind not in "iu":
        raise SceneError(f"{_OBJECTS}: {index.dtype} {index.shape} where one integer per triangle was expected")
    return np.unique(index, return_inverse=True)[1].reshape(-1)


def _connected(triangles: Float[np.ndarray, "m 3 3"], material: Float[np.ndarray, "m 10"]) -> Int[np.ndarray, " m"]:
    """Number the connected parts of one material in order of appearance, for each triangle."""
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
