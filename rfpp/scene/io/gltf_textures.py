"""Textures of glTF materials: pictures, and their coordinates on a mesh."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from rfpp.errors import SceneError
from rfpp.scene.io.gltf_file import GltfFile
from rfpp.scene.io.gltf_json import INDEX, NUMBER, PAIR, TEXT, Entry
from rfpp.scene.io.gltf_primitive import Geometry
from rfpp.scene.io.image_texture import ImageTexture, Textures, Wrap, require_few_pixels
from rfpp.scene.io.imported_scene import BEYOND

#: Extension with materials of a diffuse and a specular color.
GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
#: `wrapS` and `wrapT` of samplers; all others repeat.
_WRAPS: dict[int, Wrap] = {33071: "clamp", 33648: "mirror"}


class GltfTextures:
    """Textures of one file; those that were used last remain in memory."""

    def __init__(self, file: GltfFile) -> None:
        self.file, self._textures = file, Textures()

    @property
    def used(self) -> int:
        """Number of different textures."""
        return self._textures.used

    def require_few_pixels(self) -> None:
        """Raise SceneError for too many pixels in all pictures of its materials, before any is decoded."""
        require_few_pixels(self._pictures())

    def _pictures(self) -> Iterator[io.BytesIO]:
        """Yield each picture of a material once; unreadable ones are refused where they are needed."""
        seen = set()
        for index in range(len(self.file.document.items("materials"))):
            material = self.file.document.at("materials", index)
            pbr, glossy = material.entry("pbrMetallicRoughness"), material.entry("extensions", GLOSSINESS)
            for holder, key in (
                (pbr, "baseColorTexture"),
                (pbr, "metallicRoughnessTexture"),
                (glossy, "diffuseTexture"),
                (glossy, "specularGlossinessTexture"),
                (material, "emissiveTexture"),
                (material, "normalTexture"),
            ):
                with contextlib.suppress(SceneError):
                    source = self._source(holder.entry(key)) if key in holder else None
                    if source is not None and source not in seen:
                        seen.add(source)
                        yield io.BytesIO(self._image(source))

    def _source(self, info: Entry) -> int | None:
        texture = self.file.document.at("textures", info.get("index", INDEX, 0))
        return texture.entry("extensions", "EXT_texture_webp").get("source", INDEX, texture.get("source", INDEX))

    def lookup(self, info: Entry, geometry: Geometry, color: bool) -> tuple[ImageTexture, Float[np.ndarray, "f 3 2"]]:
        """Return a texture and its coordinates at the corners of the faces."""
        source = self._source(info)
        if source is None:
            raise SceneError(f"{info.where} has no picture that can be read: export PNG or JPEG textures")
        try:
            picture = self._textures.get(source, color, lambda: self._image(source), self._wrap(info))
        except SceneError as error:
            raise SceneError(f"images.{source}: {error}") from None
        transform = info.entry("extensions", "KHR_texture_transform")
        uv = geometry.coordinates(transform.get("texCoord", INDEX, info.get("texCoord", INDEX, 0)))
        rotation = transform.get("rotation", NUMBER, 0.0)
        cos, sin = np.cos(rotation), np.sin(rotation)
        turned = (uv * transform.get("scale", PAIR, (1, 1))) @ np.array([[cos, -sin], [sin, cos]])
        coordinates = turned + transform.get("offset", PAIR, (0, 0))
        if not (np.abs(coordinates) < BEYOND).all():
            raise SceneError(f"{info.where}: its texture coordinates are too large: unwrap the mesh again")
        return picture, coordinates

    def _wrap(self, info: Entry) -> tuple[Wrap, Wrap]:
        texture = self.file.document.at("textures", info.get("index", INDEX, 0))
        sampler = self.file.linked(texture, "sampler", "samplers")
        if sampler is None:
            return "repeat", "repeat"
        u, v = (_WRAPS.get(sampler.get(key, INDEX, 0), "repeat") for key in ("wrapS", "wrapT"))
        return u, v

    def _image(self, index: int) -> bytes:
        image = self.file.document.at("images", index)
        view = self.file.linked(image, "bufferView", "bufferViews")
        return self.file.bytes_of(image.get("uri", TEXT, "data:")) if view is None else bytes(self.file.view(view))
