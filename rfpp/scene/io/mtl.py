"""MTL, the materials of OBJ files, as rows of `SceneTriangles.material`.

The format is older than physically based shading and its numbers mean what the program that wrote them meant. Read as
Blender writes them:

| Here | MTL |
|---|---|
| with `Pr` or `Pm` | as glTF: base colour `Kd`, metallic `Pm`, roughness `Pr`, F0 0.04 |
| else diffuse | `Kd` · (1 − the largest channel of specular) |
| specular | `illum` 3 and above: `Ks`; 2, or not given: 0.08 · `Ks`, the strength of a highlight; 0 and 1: none |
| roughness | 1 − √(`Ns` / 1000) |
| emitted radiance | `Ke` |

Colours are linear, textures sRGB and multiplied with their factor after being averaged over each triangle; only
`map_Kd` and `map_Ke` are read.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError, one_line
from rfpp.scene.io.gltf_material import metallic_roughness
from rfpp.scene.io.image_texture import Textures
from rfpp.scene.io.imported_scene import DIELECTRIC
from rfpp.scene.io.limits import beside, read_bytes, require_bounded
from rfpp.scene.triangles import EMISSION

_COLOURS = {"kd": 3, "ks": 3, "ke": 3}
_NUMBERS = {"ns": 1, "d": 1, "tr": 1, "pr": 1, "pm": 1, "illum": 1}
_MAPS = ("map_kd", "map_ke", "map_d")
_MAX_BYTES = 2**24
_HIGHLIGHT = 0.08  # twice a dielectric's F0: Blender writes 0.5 for it
_TRANSPARENT_MODELS = (4, 6, 7, 9)
#: Options of a texture statement and the most numbers that follow each.
_MAP_OPTIONS = {"-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-mm": 2,
                "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-type": 1}  # fmt: skip


@dataclass
class ObjMaterial:
    """One `newmtl`.

    Attributes:
        values: statement in lower case → its numbers.
        maps: the same of textures → where their file lies.
    """

    name: str
    values: dict[str, list[float]] = field(default_factory=dict)
    maps: dict[str, Path] = field(default_factory=dict)

    @property
    def see_through(self) -> str:
        """See `Part`."""
        dissolved = self._number("d", 1.0) < 1 or self._number("tr", 0.0) > 0 or "map_d" in self.maps
        if dissolved or self._number("illum", 2.0) in _TRANSPARENT_MODELS:
            return f"material '{self.name}' (d, Tr, map_d or illum)"
        return ""

    @property
    def pictures(self) -> tuple[Path, ...]:
        """The files of the textures that are read."""
        return tuple(path for key, path in self.maps.items() if key != "map_d")

    def rows(self, uv: Float[np.ndarray, "f 3 2"] | None, faces: int, textures: Textures) -> Float[np.ndarray, "f 10"]:
        """Raises SceneError naming the material, if a texture cannot be read."""
        try:
            diffuse = np.clip(self._colour("kd", 0.8, uv, faces, textures), 0, 1)
            rows = self._surface(diffuse)
            rows[:, EMISSION] = np.maximum(self._colour("ke", 0.0, uv, faces, textures), 0)
            return rows
        except SceneError as error:
            raise SceneError(f"material '{self.name}': {error}") from None

    def _surface(self, diffuse: Float[np.ndarray, "f 3"]) -> Float[np.ndarray, "f 10"]:
        if self.values.keys() & {"pr", "pm"}:
            metallic, roughness = (
                min(max(self._number(key, value), 0.0), 1.0) for key, value in (("pm", 0.0), ("pr", 0.5))
            )
            return metallic_roughness(diffuse, metallic, roughness)
        model = self._number("illum", 2.0)
        share = 1.0 if model >= 3 else _HIGHLIGHT if model == 2 else 0.0
        specular = share * np.clip(self.values.get("ks", [DIELECTRIC / _HIGHLIGHT] * 3), 0, 1)
        roughness = 1 - math.sqrt(min(max(self._number("ns", 250.0), 0), 1000) / 1000)
        return metallic_roughness(diffuse, 0.0, roughness, specular)

    def _number(self, key: str, otherwise: float) -> float:
        return self.values.get(key, [otherwise])[0]

    def _colour(
        self, key: str, otherwise: float, uv: np.ndarray | None, faces: int, textures: Textures
    ) -> Float[np.ndarray, "f 3"]:
        path = self.maps.get(f"map_{key}")
        factor = np.tile(self.values.get(key, [1.0 if path else otherwise] * 3), (faces, 1))
        if path is None:
            return factor
        if uv is None:
            raise SceneError(f"map_{key.capitalize()} needs texture coordinates on every face: unwrap the mesh")
        try:
            return factor * textures.get(path, True, lambda: read_bytes(path)).means(uv)[:, :3]
        except SceneError as error:
            raise SceneError(f"{path}: {error}") from None


def read_mtl(path: Path) -> dict[str, ObjMaterial]:
    """The materials of a file by name. Raises SceneError naming the file and the line."""
    materials: dict[str, ObjMaterial] = {}
    current = None
    try:
        lines = read_bytes(path, _MAX_BYTES).decode("utf-8", "replace").splitlines()
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    for number, line in enumerate(lines, start=1):
        key, _, rest = line.strip().partition(" ")
        key, rest = key.lower(), rest.strip()
        try:
            if key == "newmtl":
                current = materials[rest] = ObjMaterial(one_line(rest, 60))
                require_bounded(0, len(materials))
            elif current is not None and key in _MAPS:
                current.maps[key] = beside(path.parent, _file_name(rest))
            elif current is not None and key in (_COLOURS | _NUMBERS):
                current.values[key] = _numbers(rest, (_COLOURS | _NUMBERS)[key])
        except SceneError as error:
            raise SceneError(f"{path}: line {number}: {error}") from None
    return materials


def _numbers(text: str, count: int) -> list[float]:
    try:
        values = [float(token) for token in text.split()[:3]]
    except ValueError:
        raise SceneError(f"'{one_line(text, 40)}' where numbers were expected: correct it") from None
    if not values or not all(map(math.isfinite, values)):
        raise SceneError(f"'{one_line(text, 40)}' where {count} finite numbers were expected: correct it")
    return (values * 3)[:3] if len(values) < count else values[:count]  # one number is a grey


def _file_name(text: str) -> str:
    """What follows the options of a texture statement; it may hold spaces."""
    tokens = text.split(" ")
    while tokens and tokens[0].lower() in _MAP_OPTIONS:
        numbers = _MAP_OPTIONS[tokens.pop(0).lower()]
        for place in range(numbers):
            if not tokens or (place > 0 and not _is_number(tokens[0])):
                break
            tokens.pop(0)
    return " ".join(tokens)


def _is_number(token: str) -> bool:
    return token.lstrip("+-").replace(".", "", 1).isdigit()
