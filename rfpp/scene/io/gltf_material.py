"""glTF's metallic-roughness materials as rows of `SceneTriangles.material`.

| Here | glTF |
|---|---|
| diffuse | base colour · (1 − metallic) · (1 − f), f the largest channel of F0 |
| specular | F0 · (1 − metallic) + base colour · metallic |
| F0 | ((ior − 1) / (ior + 1))² · specular factor · specular colour factor, at most 1; 0.04 by default |
| roughness | roughness: both square it |
| emitted radiance | emissive factor · emissive strength |

F0 is glTF's reflectance at normal incidence, and the specular albedo here at every angle: there is no Fresnel term. The
two albedos add up to at most 1. Textures of base colour, metallic and roughness, and emission are multiplied with the
factors after being averaged over each triangle, vertex colours with the base colour. Of an emissive texture less than a
tenth of its brightest triangle counts as none: what glows is invisible to the camera, and most such textures are dark
but for a few lights. `MASK` leaves out triangles that are transparent in the mean. Without a material: grey.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from rfpp.errors import SceneError
from rfpp.scene.io.gltf_file import GltfFile
from rfpp.scene.io.gltf_schema import Material, TextureInfo
from rfpp.scene.io.image_texture import Textures, require_few_pixels
from rfpp.scene.io.imported_scene import GREY, name_of, plain_material
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR

#: Set of texture coordinates → those of each corner [F, 3, 2].
Coordinates = Callable[[int], Float[np.ndarray, "f 3 2"]]

_GLOWS = 0.1
_OPAQUE = 0.99


@dataclass
class GltfMaterials:
    """The materials of one file.

    Attributes:
        textures: those that were averaged so far.
        normal_maps: whether any was left out.
    """

    file: GltfFile
    normal_maps: bool = False
    textures: Textures = field(default_factory=Textures)

    def rows(
        self,
        index: int | None,
        faces: int,
        coordinates: Coordinates,
        colours: Float[np.ndarray, "f 4"] | None,
    ) -> tuple[Float[np.ndarray, "f 10"], Bool[np.ndarray, " f"], str]:
        """The material of each face of a primitive, which faces are there at all, and `Part.see_through`.

        Raises:
            SceneError: naming the material, if a texture cannot be read.
        """
        if index is None:
            plain = plain_material(faces) if colours is None else metallic_roughness(colours[:, :3] * GREY, 0.0, 0.5)
            return plain, np.ones(faces, bool), ""
        material = self.file.entry(self.file.document.materials, index, "materials")
        name = f"material '{name_of(material.name, str(index))}'"
        try:
            rows, alpha = self._rows(material, faces, coordinates, colours)
        except SceneError as error:
            raise SceneError(f"{name}: {error}") from None
        present = alpha >= material.alpha_cutoff if material.alpha_mode == "MASK" else np.ones(faces, bool)
        why = _see_through(material, alpha)
        return rows, present, f"{name} ({why})" if why else ""

    def _rows(
        self, material: Material, faces: int, coordinates: Coordinates, colours: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """And the alpha of each face."""
        pbr, extensions = material.pbr_metallic_roughness, material.extensions
        self.normal_maps |= material.normal_texture is not None

        base = np.tile(np.array(pbr.base_color_factor, np.float32), (faces, 1))
        if pbr.base_color_texture is not None:
            base *= self._means(pbr.base_color_texture, coordinates, colour=True)
        if colours is not None:
            base *= colours
        metallic, roughness = (np.full(faces, value) for value in (pbr.metallic_factor, pbr.roughness_factor))
        if pbr.metallic_roughness_texture is not None:
            _, green, blue, _ = self._means(pbr.metallic_roughness_texture, coordinates, colour=False).T
            metallic, roughness = metallic * blue, roughness * green

        rows = metallic_roughness(base[:, :3], metallic, roughness, _reflectance(material))
        rows[:, EMISSION] = np.multiply(material.emissive_factor, extensions.emissive_strength.emissive_strength)
        if material.emissive_texture is not None and rows[:, EMISSION].any():
            glow = rows[:, EMISSION] * self._means(material.emissive_texture, coordinates, colour=True)[:, :3]
            rows[:, EMISSION] = np.where(glow.max(axis=1, keepdims=True) < _GLOWS * glow.max(), 0, glow)
        return rows, base[:, 3]

    def require_few_pixels(self) -> None:
        """Raises SceneError for too many in all pictures of its materials, before any is decoded."""
        require_few_pixels(self._pictures())

    def _pictures(self) -> Iterator[io.BytesIO]:
        """Each picture of a material once; what cannot be read is refused where it is needed."""
        seen = set()
        for info in (info for material in self.file.document.materials for info in _textures(material)):
            with contextlib.suppress(SceneError):
                source = self._source(info.index)
                if source is not None and source not in seen:
                    seen.add(source)
                    yield io.BytesIO(self._image(source))

    def _source(self, texture: int) -> int | None:
        """The image of a texture that can be read."""
        entry = self.file.entry(self.file.document.textures, texture, "textures")
        return entry.extensions.webp.source if entry.extensions.webp else entry.source

    def _means(self, info: TextureInfo, coordinates: Coordinates, colour: bool) -> Float[np.ndarray, "f 4"]:
        transform, source = info.extensions.transform, self._source(info.index)
        if source is None:
            raise SceneError(f"textures.{info.index} has no picture that can be read: export PNG or JPEG textures")
        try:
            picture = self.textures.get(source, colour, lambda: self._image(source))
        except SceneError as error:
            raise SceneError(f"images.{source}: {error}") from None
        if transform is None:
            return picture.means(coordinates(info.tex_coord))
        uv = coordinates(info.tex_coord if transform.tex_coord is None else transform.tex_coord)
        cos, sin = np.cos(transform.rotation), np.sin(transform.rotation)
        turned = (uv * transform.scale) @ np.array([[cos, -sin], [sin, cos]])
        return picture.means(turned + transform.offset)

    def _image(self, index: int) -> bytes:
        image = self.file.entry(self.file.document.images, index, "images")
        if image.buffer_view is None:
            return self.file.bytes_of(image.uri or "data:")
        return bytes(self.file.view(self.file.entry(self.file.document.buffer_views, image.buffer_view, "bufferViews")))


def _textures(material: Material) -> Iterator[TextureInfo]:
    """Those that are read."""
    pbr = material.pbr_metallic_roughness
    for info in (pbr.base_color_texture, pbr.metallic_roughness_texture, material.emissive_texture):
        if info is not None:
            yield info


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


def _see_through(material: Material, alpha: np.ndarray) -> str:
    """What says so, if light should pass through."""
    extensions = material.extensions
    if extensions.transmission.transmission_factor or extensions.diffuse_transmission.diffuse_transmission_factor:
        return "transmission"
    return "alphaMode BLEND" if material.alpha_mode == "BLEND" and alpha.min(initial=1) < _OPAQUE else ""


def _reflectance(material: Material) -> Float[np.ndarray, 3]:
    ior, specular = material.extensions.ior.ior, material.extensions.specular
    normal = ((ior - 1) / (ior + 1)) ** 2
    return np.minimum(np.multiply(specular.specular_color_factor, normal * specular.specular_factor), 1.0)
