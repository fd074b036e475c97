"""A scene as it comes out of a modelling program: a glTF file whose surfaces show a picture."""

from __future__ import annotations

import base64
import json
import math
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from rfpp.benchmark.exhibits import SceneFile
from rfpp.imaging.panels import save_picture
from rfpp.scene.io.image_texture import linear
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene, pack
from rfpp.scene.triangles import EMISSION, ROUGHNESS

Entries = list[dict[str, Any]]

#: Squares of the picture along each side; the grain within them, out of 255.
_SQUARES, _GRAIN = 16, 24
#: glTF's number for float32.
_FLOAT = 5126


@dataclass(frozen=True)
class Textured:
    """A stored scene as a glTF file that is written and read again, with one picture on everything that does not emit.

    Attributes:
        title, stored: see `rfpp.benchmark.lights.Relit`.
        pixels: of the picture, along each side; None is one colour instead, the picture's mean.
    """

    title: str
    stored: SceneFile
    pixels: int | None

    def scene(self) -> PackedScene:
        """Raises SceneError: see `load_scene`."""
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".*(textures are averaged|emissive parts light)", UserWarning)
            return pack(load_scene(write_gltf(self.stored.scene(), self.pixels, Path(folder) / "scene.gltf")))


def write_gltf(scene: PackedScene, pixels: int | None, path: Path) -> Path:
    """`scene` as glTF with the picture beside it, see `Textured`; each object is a node of one mesh. Returns `path`."""
    triangles = scene.triangles
    binary, views, accessors = bytearray(), Entries(), Entries()

    def accessor(rows: Float[np.ndarray, "n k"]) -> int:
        content = rows.astype("<f4").tobytes()
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(content)})
        binary.extend(content)
        kind = f"VEC{rows.shape[1]}"
        accessors.append({"bufferView": len(views) - 1, "componentType": _FLOAT, "count": len(rows), "type": kind})
        return len(accessors) - 1

    shown = picture(pixels or _SQUARES)
    surface: dict[str, Any] = {"baseColorTexture": {"index": 0}}
    if pixels is None:
        surface = {"baseColorFactor": [*linear(shown).mean(axis=(0, 1)).tolist(), 1.0]}
    else:
        save_picture(shown, path.with_suffix(".png"))
    nodes, meshes, materials = Entries(), Entries(), Entries()
    for number, name in enumerate(triangles.object_names):
        own = slice(*triangles.object_offsets[number : number + 2])
        corners, normals = triangles.positions[own], triangles.normals[own]
        attributes = {
            "POSITION": accessor(_y_up(corners.reshape(-1, 3))),
            "NORMAL": accessor(_y_up(normals.reshape(-1, 3))),
            "TEXCOORD_0": accessor(_unwrapped(corners).reshape(-1, 2)),
        }
        meshes.append({"primitives": [{"attributes": attributes, "material": number}]})
        materials.append(_material(triangles.material[own].mean(axis=0), surface))
        nodes.append({"name": name, "mesh": number})
    cameras = Entries()
    for pose, fov in zip(scene.c2w, scene.fov, strict=True):
        lens = {"yfov": math.radians(fov), "aspectRatio": 1.0, "znear": 0.01}
        nodes.append({"camera": len(cameras), "matrix": _y_up_pose(pose).T.flatten().tolist()})
        cameras.append({"type": "perspective", "perspective": lens})
    uri = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_emissive_strength"],
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": materials,
        "cameras": cameras,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary), "uri": uri}],
    }
    if pixels is not None:
        document |= {"textures": [{"source": 0}], "images": [{"uri": path.with_suffix(".png").name}]}
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def picture(pixels: int) -> UInt8[np.ndarray, "p p 3"]:
    """Squares of many colours with grain in them, sRGB; always the same."""
    rng = np.random.default_rng(0)
    colours = rng.integers(64, 224, (_SQUARES, _SQUARES, 3))
    square = np.arange(pixels) * _SQUARES // pixels
    grain = rng.integers(-_GRAIN, _GRAIN + 1, (pixels, pixels, 1))
    return (colours[square][:, square] + grain).astype(np.uint8)


def _material(row: Float[np.ndarray, 10], surface: dict[str, Any]) -> dict[str, Any]:
    """An emitter as strong as the row says; else a surface as rough as it says, of no metal."""
    strength = row[EMISSION].max().item()
    if not strength:
        return {"pbrMetallicRoughness": surface | {"metallicFactor": 0.0, "roughnessFactor": row[ROUGHNESS].item()}}
    return {
        "pbrMetallicRoughness": {"metallicFactor": 0.0},
        "emissiveFactor": (row[EMISSION] / strength).tolist(),
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": strength}},
    }


def _unwrapped(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3 2"]:
    """Texture coordinates: each triangle projected along the axis that it faces most."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    kept = np.array([[1, 2], [0, 2], [0, 1]])[np.abs(normals).argmax(axis=1)]
    return np.take_along_axis(corners, np.repeat(kept[:, None], 3, axis=1), axis=2) + 0.5


def _y_up(rows: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return rows[:, [0, 2, 1]] * np.array([1, 1, -1])


def _y_up_pose(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Camera axes are the same on both sides."""
    turned = pose.astype(np.float64)
    turned[:3] = _y_up(pose[:3].T).T
    return turned
