"""Materials as glTF has them: the numbers of a Principled BSDF, and pictures of its colours.

As Blender's own exporter does it, so that a scene that is sent looks like the scene that is exported.
"""

from __future__ import annotations

import numpy as np

from .glb import Glb, png
from .left_out import LeftOut
from .nodes import constant, source, surface_of, tree_of

#: Pixels along the longer side of pictures: they are averaged over triangles in the end.
_SIDE = 1024

_WITH_PICTURES = ("Base Color", "Emission Color")
_IGNORED = {
    "Subsurface Weight": "Subsurface scattering is left out",
    "Coat Weight": "Coats are left out",
    "Sheen Weight": "Sheen is left out",
    "Anisotropic": "Anisotropy is left out",
    "Thin Film Thickness": "Thin films are left out",
}


class Materials:
    """Of one scene.

    Args:
        pictures: PNG files by the name of their image, kept from one scene to the next.
    """

    def __init__(self, glb: Glb, left_out: LeftOut, pictures: dict[str, bytes]) -> None:
        self._glb, self._left_out, self._pictures = glb, left_out, pictures
        self._numbers: dict[str, int] = {}
        self._textures: dict[str, int] = {}

    def number(self, material) -> int | None:
        """Of the entry of a `bpy.types.Material`; None for none."""
        if material is None:
            return None
        if material.name_full not in self._numbers:
            self._numbers[material.name_full] = self._glb.add("materials", self._gltf_material(material))
        return self._numbers[material.name_full]

    def _gltf_material(self, material) -> dict:
        shader = surface_of(material)
        if shader is not None and shader.type == "BSDF_PRINCIPLED":
            return {"name": material.name} | self._principled(material, shader)
        if shader is not None and shader.type == "EMISSION":
            entry = _surface((0, 0, 0), 0.0, 1.0) | _specular(0.0)
            glow = self._colour(material, shader, "Color"), self._value(material, shader, "Strength")
            return {"name": material.name} | _with_emission(entry, *glow)
        if tree_of(material) is not None:
            self._left_out.add("Materials without a Principled BSDF have their viewport colour", material.name)
        return {"name": material.name} | _surface(material.diffuse_color, material.metallic, material.roughness)

    def _principled(self, material, shader) -> dict:
        metallic, roughness, ior = (self._value(material, shader, name) for name in ("Metallic", "Roughness", "IOR"))
        picture = self._picture(material, shader, "Base Color")
        colour = (1, 1, 1) if picture else self._colour(material, shader, "Base Color")
        entry = _surface(colour, metallic, roughness)
        if picture:
            entry["pbrMetallicRoughness"]["baseColorTexture"] = picture
        factor = 2 * self._value(material, shader, "Specular IOR Level")  # 0.5 is what the index of refraction gives
        entry |= _specular(factor, self._colour(material, shader, "Specular Tint"), ior)
        alpha, transmission = constant(shader.inputs["Alpha"]), constant(shader.inputs["Transmission Weight"])
        if alpha is None or alpha < 1 or transmission is None or transmission > 0:
            self._left_out.add("Transparent materials are opaque", material.name)
        for name, what in _IGNORED.items():
            if name in shader.inputs and (shader.inputs[name].is_linked or shader.inputs[name].default_value > 0):
                self._left_out.add(what, material.name)
        if any(name in shader.inputs and shader.inputs[name].is_linked for name in ("Normal", "Coat Normal")):
            self._left_out.add("Normal and bump maps are left out", material.name)
        strength = self._value(material, shader, "Emission Strength")
        entry = _with_emission(entry, self._colour(material, shader, "Emission Color"), strength)
        if strength > 0 and (glow := self._picture(material, shader, "Emission Color")):
            entry = _with_emission(entry, (1, 1, 1), strength) | {"emissiveTexture": glow}
        return entry

    def _value(self, material, shader, name: str) -> float:
        return float(self._constant(material, shader, name)) if name in shader.inputs else 0.0

    def _colour(self, material, shader, name: str) -> tuple[float, float, float]:
        return tuple(self._constant(material, shader, name))[:3]

    def _constant(self, material, shader, name: str):
        if (value := constant(shader.inputs[name])) is not None:
            return value
        if not (name in _WITH_PICTURES and _is_picture(source(shader.inputs[name]))):
            self._left_out.add("Inputs driven by nodes have their own value", f"{name} of {material.name}")
        return shader.inputs[name].default_value

    def _picture(self, material, shader, name: str) -> dict | None:
        """Of an image node that a colour comes from straight."""
        node = source(shader.inputs[name])
        if node is None or not _is_picture(node):
            return None
        if (placed := source(node.inputs["Vector"])) is not None and placed.type != "UVMAP":
            self._left_out.add("Textures lie as the active UV map has them", f"{name} of {material.name}")
        image = node.image
        if image.name_full not in self._textures:
            if image.name_full not in self._pictures:
                self._pictures[image.name_full] = _png(image)
            self._textures[image.name_full] = self._glb.texture(self._pictures[image.name_full])
        return {"index": self._textures[image.name_full]}


def _is_picture(node) -> bool:
    return node.type == "TEX_IMAGE" and node.image is not None and all(node.image.size)


def _png(image) -> bytes:
    """Of an image data-block, at most so large."""
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(height, width, image.channels)[::-1]
    step = -(-max(width, height) // _SIDE)
    values = np.mean([values[i : height - step + 1 + i : step, j : width - step + 1 + j : step] for i in range(step)
                      for j in range(step)], axis=0)  # fmt: skip
    rgba = np.ones((*values.shape[:2], 4), np.float32)
    rgba[..., : values.shape[-1]] = values if values.shape[-1] > 1 else 1.0
    if values.shape[-1] < 3:
        rgba[..., :3] = values[..., :1]
    if image.is_float:  # linear; files of 8 bits come as they are stored
        rgba[..., :3] = _srgb(rgba[..., :3])
    return png((np.clip(rgba, 0, 1) * 255).round().astype(np.uint8))


def _srgb(linear: np.ndarray) -> np.ndarray:
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def _surface(colour, metallic: float, roughness: float) -> dict:
    *rgb, metallic, roughness = (min(max(float(value), 0.0), 1.0) for value in (*colour[:3], metallic, roughness))
    pbr = {"baseColorFactor": [*rgb, 1.0], "metallicFactor": metallic, "roughnessFactor": roughness}
    return {"pbrMetallicRoughness": pbr, "extensions": {}}


def _specular(factor: float, tint=(1.0, 1.0, 1.0), ior: float = 1.5) -> dict:
    """A factor above 1 is part of the colour, as glTF has it."""
    colour = [max(0.0, float(c)) * max(factor, 1.0) for c in tint]
    specular = {"specularFactor": min(max(factor, 0.0), 1.0), "specularColorFactor": colour}
    return {"extensions": {"KHR_materials_specular": specular, "KHR_materials_ior": {"ior": max(float(ior), 0.0)}}}


def _with_emission(entry: dict, colour, strength: float) -> dict:
    emitted = [max(0.0, float(c) * float(strength)) for c in colour]
    brightest = max(1.0, *emitted)
    extensions = entry["extensions"] | {"KHR_materials_emissive_strength": {"emissiveStrength": brightest}}
    return entry | {"emissiveFactor": [value / brightest for value in emitted], "extensions": extensions}
