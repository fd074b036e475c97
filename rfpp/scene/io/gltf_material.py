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
factors after being averaged over each triangle, vertex colors with the base color. Of an emissive texture less than a
tenth of its brightest triangle counts as none: what glows is invisible to the camera, and most such textures are dark
but for a few lights. `MASK` leaves out triangles that are transparent in the mean. Without a material: gray.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from rfpp.errors import SceneError
from rfpp.scene.io.gltf_file import GltfFile
from rfpp.scene.io.gltf_json import INDEX, NUMBER, PAIR, POSITIVE, RGB, RGBA, SHARE, TEXT, Entry
from rfpp.scene.io.gltf_primitive import Geometry
from rfpp.scene.io.image_texture import Textures, require_few_pixels
from rfpp.scene.io.imported_scene import GREY, name_of, plain_material
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR

_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
#: Extensions of materials that are represented, or that say nothing beyond others.
_KNOWN = {"diffuse_transmission", "emissive_strength", "ior", "pbrSpecularGlossiness", "specular", "transmission",
          "volume"}  # fmt: skip
_GLOWS = 0.1
_OPAQUE = 0.99
#: Rows of the faces, and their alpha.
_Surface = tuple[Float[np.ndarray, "f 10"], Float[np.ndarray, " f"]]


@dataclass
class GltfMaterials:
    """Materials of one file.

    Attributes:
        left_out: names of what materials have and rows do not represent.
    """

    file: GltfFile
    left_out: set[str] = field(default_factory=set)
    textures: Textures = field(default_factory=Textures)

    def rows(
        self, material: Entry | None, geometry: Geometry
    ) -> tuple[Float[np.ndarray, "f 10"], Bool[np.ndarray, " f"], str]:
        """Return the material of each face, a mask of faces that are present, and `Part.see_through`.

        Raises:
            SceneError: If a value is invalid or a texture cannot be read; names the material.
        """
        faces, colors = len(geometry.faces), geometry.colors
        if material is None:
            plain = plain_material(faces) if colors is None else metallic_roughness(colors[:, :3] * GREY, 0.0, 0.5)
            return plain, np.ones(faces, bool), ""
        name = f"material '{name_of(material.get('name', TEXT, ''), material.where)}'"
        try:
            rows, alpha = self._rows(material, geometry, colors)
        except SceneError as error:
            raise SceneError(f"{name}: {error}") from None
        mode = material.get("alphaMode", TEXT, "OPAQUE")
        present = alpha >= material.get("alphaCutoff", POSITIVE, 0.5) if mode == "MASK" else np.ones(faces, bool)
        why = "alphaMode BLEND" if mode == "BLEND" and alpha.min(initial=1) < _OPAQUE else ""
        for kind, factor in (
            ("transmission", "transmissionFactor"),
            ("diffuse_transmission", "diffuseTransmissionFactor"),
        ):
            why = "transmission" if _extension(material, kind).get(factor, SHARE, 0.0) else why
        return rows, present, f"{name} ({why})" if why else ""

    def _rows(self, material: Entry, geometry: Geometry, colors: np.ndarray | None) -> _Surface:
        self.left_out |= {name.removeprefix("KHR_materials_") for name in material.entry("extensions").values} - _KNOWN
        if "normalTexture" in material:
            self.left_out.add("normal maps")
        surface = self._specular if _GLOSSINESS in material.entry("extensions") else self._metallic
        rows, alpha = surface(material, geometry, colors)
        strength = _extension(material, "emissive_strength").get("emissiveStrength", POSITIVE, 1.0)
        rows[:, EMISSION] = np.multiply(material.get("emissiveFactor", RGB, (0, 0, 0)), strength)
        if "emissiveTexture" in material and rows[:, EMISSION].any():
            glow = rows[:, EMISSION] * self._means(material.entry("emissiveTexture"), geometry, color=True)[:, :3]
            rows[:, EMISSION] = np.where(glow.max(axis=1, keepdims=True) < _GLOWS * glow.max(), 0, glow)
        return rows, alpha

    def _metallic(self, material: Entry, geometry: Geometry, colors: np.ndarray | None) -> _Surface:
        pbr, faces = material.entry("pbrMetallicRoughness"), len(geometry.faces)
        base = self._color(pbr, "baseColor", geometry, colors)
        metallic, roughness = (
            np.full(faces, pbr.get(key, SHARE, 1.0)) for key in ("metallicFactor", "roughnessFactor")
        )
        if "metallicRoughnessTexture" in pbr:
            _, green, blue, _ = self._means(pbr.entry("metallicRoughnessTexture"), geometry, color=False).T
            metallic, roughness = metallic * blue, roughness * green
        return metallic_roughness(base[:, :3], metallic, roughness, _reflectance(material)), base[:, 3]

    def _specular(self, material: Entry, geometry: Geometry, colors: np.ndarray | None) -> _Surface:
        pbr, faces = material.entry("extensions", _GLOSSINESS), len(geometry.faces)
        diffuse = self._color(pbr, "diffuse", geometry, colors)
        specular = np.tile(np.minimum(pbr.get("specularFactor", RGB, (1, 1, 1)), 1.0), (faces, 1))
        glossiness = np.full(faces, pbr.get("glossinessFactor", SHARE, 1.0))
        if "specularGlossinessTexture" in pbr:
            means = self._means(pbr.entry("specularGlossinessTexture"), geometry, color=True)
            specular, glossiness = specular * means[:, :3], glossiness * means[:, 3]
        rows = np.zeros((faces, 10), np.float32)
        rows[:, DIFFUSE] = diffuse[:, :3] * (1 - specular.max(axis=1, keepdims=True))
        rows[:, SPECULAR], rows[:, ROUGHNESS] = specular, 1 - glossiness[:, None]
        return rows, diffuse[:, 3]

    def _color(self, pbr: Entry, name: str, geometry: Geometry, colors: np.ndarray | None) -> Float[np.ndarray, "f 4"]:
        """Return the product of a factor, its texture and vertex colors."""
        color = np.tile(np.array(pbr.get(f"{name}Factor", RGBA, (1, 1, 1, 1)), np.float32), (len(geometry.faces), 1))
        if f"{name}Texture" in pbr:
            color *= self._means(pbr.entry(f"{name}Texture"), geometry, color=True)
        return color if colors is None else color * colors

    def require_few_pixels(self) -> None:
        """Raise SceneError for too many pixels in all pictures of its materials, before any is decoded."""
        require_few_pixels(self._pictures())

    def _pictures(self) -> Iterator[io.BytesIO]:
        """Yield each picture of a material once; unreadable ones are refused where they are needed."""
        seen = set()
        for index in range(len(self.file.document.items("materials"))):
            material = self.file.document.at("materials", index)
            pbr, glossy = material.entry("pbrMetallicRoughness"), material.entry("extensions", _GLOSSINESS)
            for holder, key in (
                (pbr, "baseColorTexture"),
                (pbr, "metallicRoughnessTexture"),
                (glossy, "diffuseTexture"),
                (glossy, "specularGlossinessTexture"),
                (material, "emissiveTexture"),
            ):
                with contextlib.suppress(SceneError):
                    source = self._source(holder.entry(key)) if key in holder else None
                    if source is not None and source not in seen:
                        seen.add(source)
                        yield io.BytesIO(self._image(source))

    def _source(self, info: Entry) -> int | None:
        texture = self.file.document.at("textures", info.get("index", INDEX, 0))
        return texture.entry("extensions", "EXT_texture_webp").get("source", INDEX, texture.get("source", INDEX))

    def _means(self, info: Entry, geometry: Geometry, color: bool) -> Float[np.ndarray, "f 4"]:
        source = self._source(info)
        if source is None:
            raise SceneError(f"{info.where} has no picture that can be read: export PNG or JPEG textures")
        try:
            picture = self.textures.get(source, color, lambda: self._image(source))
        except SceneError as error:
            raise SceneError(f"images.{source}: {error}") from None
        transform = info.entry("extensions", "KHR_texture_transform")
        uv = geometry.coordinates(transform.get("texCoord", INDEX, info.get("texCoord", INDEX, 0)))
        rotation = transform.get("rotation", NUMBER, 0.0)
        cos, sin = np.cos(rotation), np.sin(rotation)
        turned = (uv * transform.get("scale", PAIR, (1, 1))) @ np.array([[cos, -sin], [sin, cos]])
        return picture.means(turned + transform.get("offset", PAIR, (0, 0)))

    def _image(self, index: int) -> bytes:
        image = self.file.document.at("images", index)
        view = self.file.linked(image, "bufferView", "bufferViews")
        return self.file.bytes_of(image.get("uri", TEXT, "data:")) if view is None else bytes(self.file.view(view))


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
