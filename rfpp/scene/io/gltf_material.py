"""glTF's metallic-roughness materials as rows of `SceneTriangles.material`.

| Here | glTF |
|---|---|
| diffuse | base color · (1 − metallic) · (1 − f), f the largest channel of F0 |
| specular | F0 · (1 − metallic) + base color · metallic |
| F0 | ((ior − 1) / (ior + 1))² · specular factor · specular color factor, at most 1; 0.04 by default |
| roughness | roughness: both square it |
| emitted radiance | emissive factor · emissive strength, of the front only unless `doubleSided` |

With `KHR_materials_pbrSpecularGlossiness`: diffuse · (1 − largest specular), specular, and 1 − glossiness.

F0 is glTF's reflectance at normal incidence, and the specular albedo here at every angle: there is no Fresnel term. The
two albedos add up to at most 1. Textures of base color, metallic and roughness, and emission are multiplied with the
factors after being averaged over each texel or triangle, vertex colors with the base color. Of an emissive texture less
than a tenth of its brightest triangle counts as none: what glows is invisible to the camera, and most such textures are
dark but for a few lights. Without a material: gray.

`MASK` omits triangles that are transparent in the mean, and so does `BLEND`, at 0.5, with a texture whose alpha is
that of a mask. Where textures vary, triangles are subdivided, see `texture_detail`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from rfpp.errors import SceneError
from rfpp.scene.io.gltf_json import NUMBER, POSITIVE, RGB, RGBA, SHARE, TEXT, Entry
from rfpp.scene.io.gltf_primitive import Geometry
from rfpp.scene.io.gltf_textures import GLOSSINESS, GltfTextures
from rfpp.scene.io.image_texture import ImageTexture
from rfpp.scene.io.imported_scene import GREY, name_of, plain_material
from rfpp.scene.io.pieces import Pieces
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR

#: Extensions of materials that are represented, or that say nothing beyond others.
_KNOWN = {"diffuse_transmission", "emissive_strength", "ior", "pbrSpecularGlossiness", "specular", "transmission",
          "volume"}  # fmt: skip
_GLOWS = 0.1
_OPAQUE = 0.99
#: Limit of the scale of normal maps; beyond it normals lie in the surface.
_STEEPEST = 1e6
#: Standard deviation of alpha within a face that tells a cut-out from glass.
_CUT_OUT = 0.2


@dataclass(frozen=True, eq=False)
class GltfSurface:
    """A material on a mesh, see `texture_detail.Surface`.

    Every method raises SceneError naming the material if a value is invalid or a texture cannot be read.
    """

    textures: GltfTextures
    material: Entry | None
    geometry: Geometry

    @property
    def omitted(self) -> set[str]:
        """Names of the material's properties that rows do not represent."""
        if self.material is None:
            return set()
        return {name.removeprefix("KHR_materials_") for name in self.material.entry("extensions").values} - _KNOWN

    @property
    def _is_textured(self) -> bool:
        """True if its color, alpha or emission is a picture."""
        if self.material is None:
            return False
        return self._color_name + "Texture" in self._pbr or "emissiveTexture" in self.material

    @property
    def see_through(self) -> str:
        """See `Part`."""
        if self.material is None:
            return ""
        with self._named():
            why = ""
            if self.material.get("alphaMode", TEXT, "OPAQUE") == "BLEND" and not self._is_cut:
                alpha = self._color(Pieces.whole(self.geometry.corners))[:, 3]
                why = "alphaMode BLEND" if alpha.min(initial=1) < _OPAQUE else ""
            for kind, factor in (
                ("transmission", "transmissionFactor"),
                ("diffuse_transmission", "diffuseTransmissionFactor"),
            ):
                why = "transmission" if _extension(self.material, kind).get(factor, SHARE, 0.0) else why
            return f"{self._name} ({why})" if why else ""

    def rows(self, pieces: Pieces) -> tuple[Float[np.ndarray, "n 10"], Bool[np.ndarray, " n"]]:
        if self.material is None:
            colors, count = self.geometry.colors, len(pieces)
            plain = (
                plain_material(count)
                if colors is None
                else metallic_roughness(pieces.of(colors).mean(axis=1)[:, :3] * GREY, 0.0, 0.5)
            )
            return plain, np.ones(count, bool)
        with self._named():
            base = self._color(pieces)
            rows = self._specular(base, pieces) if self._is_glossy else self._metallic(base, pieces)
            rows[:, EMISSION] = self._emission(pieces)
            cutoff = self.material.get("alphaCutoff", POSITIVE, 0.5)
            return rows, base[:, 3] >= cutoff if self._is_cut else np.ones(len(pieces), bool)

    def spread(self, pieces: Pieces) -> Float[np.ndarray, " n"]:
        spread = np.zeros(len(pieces))
        if not self._is_textured:
            return spread
        with self._named():
            if (name := f"{self._color_name}Texture") in self._pbr:
                picture, uv = self._lookup(self._pbr.entry(name), color=True)
                spreads = picture.spreads(pieces.of(uv)) * self._pbr.get(f"{self._color_name}Factor", RGBA, (1,) * 4)
                spread = spreads[:, : 4 if self._is_cut else 3].max(axis=1)
            if "emissiveTexture" in self.material and any(self.material.get("emissiveFactor", RGB, (0, 0, 0))):
                picture, uv = self._lookup(self.material.entry("emissiveTexture"), color=True)
                spread = np.maximum(spread, picture.spreads(pieces.of(uv))[:, :3].max(axis=1))
            return spread

    def pixels_along(self, pieces: Pieces) -> Float[np.ndarray, " n"]:
        along = np.zeros(len(pieces))
        if self.material is None:
            return along
        with self._named():
            for holder, name, color in (
                (self._pbr, f"{self._color_name}Texture", True),
                (self._pbr, "specularGlossinessTexture", True),
                (self._pbr, "metallicRoughnessTexture", False),
                (self.material, "normalTexture", False),
            ):
                if name in holder:
                    picture, uv = self._lookup(holder.entry(name), color)
                    along = np.maximum(along, picture.pixels_along(pieces.of(uv)))
            return along

    def normals(self, pieces: Pieces) -> Float[np.ndarray, "n 3"] | None:
        if self.material is None or "normalTexture" not in self.material:
            return None
        with self._named():
            info = self.material.entry("normalTexture")
            scale = np.clip(info.get("scale", NUMBER, 1.0), -_STEEPEST, _STEEPEST)
            normals = (2 * self._means(info, pieces, color=False)[:, :3] - 1) * (scale, scale, 1)
            return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)

    def coordinates(self, pieces: Pieces) -> Float[np.ndarray, "n 3 2"] | None:
        if self.material is None or "normalTexture" not in self.material:
            return None
        return pieces.of(self._lookup(self.material.entry("normalTexture"), color=False)[1])

    @cached_property
    def _is_cut(self) -> bool:
        """True for cut-outs: a mask, or blending with a picture whose alpha is that of a mask."""
        mode, name = self.material.get("alphaMode", TEXT, "OPAQUE"), f"{self._color_name}Texture"
        if mode != "BLEND" or name not in self._pbr:
            return mode == "MASK"
        picture, uv = self._lookup(self._pbr.entry(name), color=True)
        return bool((picture.spreads(uv)[:, 3] > _CUT_OUT).any())

    @property
    def _is_glossy(self) -> bool:
        return GLOSSINESS in self.material.entry("extensions")

    @property
    def _pbr(self) -> Entry:
        return self.material.entry(*(("extensions", GLOSSINESS) if self._is_glossy else ("pbrMetallicRoughness",)))

    @property
    def _color_name(self) -> str:
        return "diffuse" if self._is_glossy else "baseColor"

    def _color(self, pieces: Pieces) -> Float[np.ndarray, "n 4"]:
        """Return the product of the color's factor, its texture and vertex colors."""
        factor = self._pbr.get(f"{self._color_name}Factor", RGBA, (1, 1, 1, 1))
        color = np.tile(np.array(factor, np.float32), (len(pieces), 1))
        if (name := f"{self._color_name}Texture") in self._pbr:
            color *= self._means(self._pbr.entry(name), pieces, color=True)
        colors = self.geometry.colors
        return color if colors is None else color * pieces.of(colors).mean(axis=1).astype(np.float32)

    def _metallic(self, base: Float[np.ndarray, "n 4"], pieces: Pieces) -> Float[np.ndarray, "n 10"]:
        metallic, roughness = (
            np.full(len(pieces), self._pbr.get(key, SHARE, 1.0)) for key in ("metallicFactor", "roughnessFactor")
        )
        if "metallicRoughnessTexture" in self._pbr:
            _, green, blue, _ = self._means(self._pbr.entry("metallicRoughnessTexture"), pieces, color=False).T
            metallic, roughness = metallic * blue, roughness * green
        return metallic_roughness(base[:, :3], metallic, roughness, _reflectance(self.material))

    def _specular(self, diffuse: Float[np.ndarray, "n 4"], pieces: Pieces) -> Float[np.ndarray, "n 10"]:
        specular = np.tile(np.minimum(self._pbr.get("specularFactor", RGB, (1, 1, 1)), 1.0), (len(pieces), 1))
        glossiness = np.full(len(pieces), self._pbr.get("glossinessFactor", SHARE, 1.0))
        if "specularGlossinessTexture" in self._pbr:
            means = self._means(self._pbr.entry("specularGlossinessTexture"), pieces, color=True)
            specular, glossiness = specular * means[:, :3], glossiness * means[:, 3]
        rows = np.zeros((len(pieces), 10), np.float32)
        rows[:, DIFFUSE] = diffuse[:, :3] * (1 - specular.max(axis=1, keepdims=True))
        rows[:, SPECULAR], rows[:, ROUGHNESS] = specular, 1 - glossiness[:, None]
        return np.clip(rows, 0, 1)

    def _emission(self, pieces: Pieces) -> Float[np.ndarray, "n 3"]:
        strength = _extension(self.material, "emissive_strength").get("emissiveStrength", POSITIVE, 1.0)
        factor = np.multiply(self.material.get("emissiveFactor", RGB, (0, 0, 0)), strength)
        if "emissiveTexture" not in self.material or not factor.any():
            return np.tile(factor, (len(pieces), 1))
        glow = factor * self._means(self.material.entry("emissiveTexture"), pieces, color=True)[:, :3]
        return np.where(glow.max(axis=1, keepdims=True) < _GLOWS * glow.max(), 0, glow)

    def _means(self, info: Entry, pieces: Pieces, color: bool) -> Float[np.ndarray, "n 4"]:
        picture, uv = self._lookup(info, color)
        return picture.means(pieces.of(uv))

    def _lookup(self, info: Entry, color: bool) -> tuple[ImageTexture, Float[np.ndarray, "f 3 2"]]:
        return self.textures.lookup(info, self.geometry, color)

    @property
    def _name(self) -> str:
        return f"material '{name_of(self.material.get('name', TEXT, ''), self.material.where)}'"

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except SceneError as error:
            raise SceneError(f"{self._name}: {error}") from None


def _extension(material: Entry, name: str) -> Entry:
    return material.entry("extensions", f"KHR_materials_{name}")


def metallic_roughness(
    base: Float[np.ndarray, "f 3"],
    metallic: Float[np.ndarray, " f"] | float,
    roughness: Float[np.ndarray, " f"] | float,
    reflectance: Float[np.ndarray, 3] | float = 0.04,
) -> Float[np.ndarray, "f 10"]:
    """Rows of the table above, without emission; `reflectance` is F0."""
    rows = np.zeros((len(base), 10), np.float32)
    metal, dielectric = (np.broadcast_to(share, len(base))[:, None] for share in (metallic, np.subtract(1, metallic)))
    rows[:, DIFFUSE] = base * dielectric * (1 - np.max(reflectance))
    rows[:, SPECULAR] = reflectance * dielectric + base * metal
    rows[:, ROUGHNESS] = np.broadcast_to(roughness, len(base))[:, None]
    return np.clip(rows, 0, 1)


def _reflectance(material: Entry) -> Float[np.ndarray, 3]:
    ior, specular = _extension(material, "ior").get("ior", POSITIVE, 1.5), _extension(material, "specular")
    normal = ((ior - 1) / (ior + 1)) ** 2 * specular.get("specularFactor", SHARE, 1.0)
    return np.minimum(np.multiply(specular.get("specularColorFactor", RGB, (1, 1, 1)), normal), 1.0)
