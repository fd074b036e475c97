"""MTL, the materials of OBJ files, as rows of `SceneTriangles.material` (data/conventions.md).

Numbers mean what Blender means by them. Colors are linear; textures are sRGB, averaged over each piece and
multiplied with their color. trimesh omits unreadable parts, such as a missing texture; here they are errors.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.gltf_material import metallic_roughness
from rfpp.scene.io.image_texture import ImageTexture, Textures
from rfpp.scene.io.imported_scene import BEYOND
from rfpp.scene.io.limits import beside, read_bytes, require_bounded
from rfpp.scene.io.pieces import Pieces
from rfpp.scene.io.trimesh_files import TrimeshArrays
from rfpp.scene.triangles import EMISSION

#: Numbers that are read, and their defaults.
_DEFAULTS = {"kd": (0.8,) * 3, "ks": (0.5,) * 3, "ke": (0.0,) * 3, "ns": (250.0,), "illum": (2.0,), "pr": (0.5,),
             "pm": (0.0,), "d": (1.0,), "tr": (0.0,)}  # fmt: skip
_MAPS = {"map_kd": "kd", "map_ke": "ke", "map_d": "d"}
_OTHER_MAPS = ("bump", "disp", "decal", "norm", "refl")
_MAX_BYTES = 2**24
_HIGHLIGHT = 0.08  # twice a dielectric's F0: Blender writes 0.5 for it
_TRANSPARENT_MODELS = (4, 6, 7, 9)
#: Options before the file name of a texture, such as `-s 1 1 1 -clamp on`.
_MAP_OPTIONS = re.compile(r"(?:-[a-z]+(?: +(?:on|off|[a-z]|sphere|cube_\w+|[-+.\de]+))+ +)*", re.IGNORECASE)


@dataclass
class ObjMaterial:
    """One `newmtl`: numbers and textures by statement in lower case, and statements of textures that are not read."""

    name: str
    values: dict[str, list[float]] = field(default_factory=dict)
    textures: dict[str, Path] = field(default_factory=dict)
    omitted: set[str] = field(default_factory=set)

    @property
    def see_through(self) -> str:
        """See `Part`."""
        d, tr, model = (self._value(key)[0] for key in ("d", "tr", "illum"))
        is_opaque = d >= 1 and tr <= 0 and "d" not in self.textures and model not in _TRANSPARENT_MODELS
        return "" if is_opaque else f"material '{self.name}' (d, Tr, map_d or illum)"

    @property
    def is_textured(self) -> bool:
        """True if its color or emission is a picture."""
        return not self.textures.keys().isdisjoint(("kd", "ke"))

    def rows(self, pieces: Pieces, mesh: TrimeshArrays, textures: Textures) -> Float[np.ndarray, "n 10"]:
        """Return the material of each piece. Raises SceneError naming the material, if a texture cannot be read."""
        base = np.clip(self._color("kd", pieces, mesh, textures), 0, 1)
        metallic, roughness, reflectance = self._value("pm")[0], self._value("pr")[0], 0.04
        if not self.values.keys() & {"pr", "pm"}:
            model = self._value("illum")[0]
            reflectance = np.clip(self._value("ks"), 0, 1) * (1.0 if model >= 3 else _HIGHLIGHT if model == 2 else 0.0)
            roughness = 1 - math.sqrt(np.clip(self._value("ns")[0], 0, 1000) / 1000)
        rows = metallic_roughness(base, np.clip(metallic, 0, 1), np.clip(roughness, 0, 1), reflectance)
        rows[:, EMISSION] = np.maximum(self._color("ke", pieces, mesh, textures), 0)
        return rows

    def _value(self, key: str) -> list[float] | tuple[float, ...]:
        return self.values.get(key, _DEFAULTS[key])

    def spread(self, pieces: Pieces, mesh: TrimeshArrays, textures: Textures) -> Float[np.ndarray, " n"]:
        """Return the standard deviation of its color within each piece."""
        if "kd" not in self.textures:
            return np.zeros(len(pieces))
        picture, uv = self._picture("kd", mesh, textures)
        return (picture.spreads(pieces.of(uv))[:, :3] * self.values.get("kd", [1.0] * 3)).max(axis=1)

    def pixels_along(self, pieces: Pieces, mesh: TrimeshArrays, textures: Textures) -> Float[np.ndarray, " n"]:
        """Return the pixels of its color's texture along each piece; 0 where it hardly varies."""
        if "kd" not in self.textures:
            return np.zeros(len(pieces))
        picture, uv = self._picture("kd", mesh, textures)
        return picture.pixels_along(pieces.of(uv))

    def _color(self, key: str, pieces: Pieces, mesh: TrimeshArrays, textures: Textures) -> Float[np.ndarray, "n 3"]:
        if key not in self.textures:
            return np.tile(self._value(key), (len(pieces), 1))
        picture, uv = self._picture(key, mesh, textures)
        return picture.means(pieces.of(uv))[:, :3] * self.values.get(key, [1.0] * 3)

    def _picture(
        self, key: str, mesh: TrimeshArrays, textures: Textures
    ) -> tuple[ImageTexture, Float[np.ndarray, "f 3 2"]]:
        """Return a texture and its coordinates at the corners of the faces."""
        path, uv = self.textures[key], mesh["visual"].uv
        if uv is None or not (np.abs(uv) < BEYOND).all():
            raise SceneError(
                f"material '{self.name}': map_{key.capitalize()} needs texture coordinates: unwrap the mesh"
            )
        try:
            picture = textures.get(path, True, lambda: read_bytes(path))
        except SceneError as error:
            raise SceneError(f"material '{self.name}': {path}: {error}") from None
        return picture, uv[mesh["faces"]] * (1, -1) + (0, 1)


@dataclass(frozen=True)
class ObjSurface:
    """A textured material on a mesh, see `texture_detail.Surface`."""

    material: ObjMaterial
    mesh: TrimeshArrays
    textures: Textures

    def rows(self, pieces: Pieces) -> tuple[Float[np.ndarray, "n 10"], Bool[np.ndarray, " n"]]:
        return self.material.rows(pieces, self.mesh, self.textures), np.ones(len(pieces), bool)

    def spread(self, pieces: Pieces) -> Float[np.ndarray, " n"]:
        return self.material.spread(pieces, self.mesh, self.textures)

    def pixels_along(self, pieces: Pieces) -> Float[np.ndarray, " n"]:
        return self.material.pixels_along(pieces, self.mesh, self.textures)

    def normals(self, pieces: Pieces) -> None:
        return None

    def coordinates(self, pieces: Pieces) -> None:
        return None


def read_mtl(path: Path) -> dict[str, ObjMaterial]:
    """Read the materials of a file by name. Raises SceneError naming the file and the line."""
    materials: dict[str, ObjMaterial] = {}
    where, current = f"{path}", ObjMaterial("")
    try:
        lines = read_bytes(path, _MAX_BYTES).decode("utf-8", "replace").splitlines()
        for number, line in enumerate(lines, start=1):
            where = f"{path}: line {number}"
            key, *words = line.split() or [""]
            key, rest = key.lower(), " ".join(words)
            if key == "newmtl":
                current = materials[rest] = ObjMaterial(one_line(rest, 60))
                require_bounded(0, len(materials))
            elif key in _MAPS:
                current.textures[_MAPS[key]] = beside(path.parent, _MAP_OPTIONS.sub("", rest, count=1))
            elif key in _DEFAULTS:
                current.values[key] = _numbers(words, len(_DEFAULTS[key]))
            elif key.startswith("map_") or key in _OTHER_MAPS:
                current.omitted.add(one_line(key, 20))
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from None
    return materials


def _numbers(words: list[str], count: int) -> list[float]:
    try:
        values = [float(word) for word in words[:count]]
    except ValueError:
        values = []
    if not values or not all(map(math.isfinite, values)):
        raise SceneError(f"'{one_line(' '.join(words), 40)}' where {count} finite numbers were expected: correct it")
    return values if len(values) == count else values[:1] * count  # one number is a gray
