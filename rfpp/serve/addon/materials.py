"""Export materials: numbers of a Principled BSDF, and images of its colors, as in Blender's own exporter of glTF."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from .glb import Glb, png

#: Kind of deviation from Blender → names of the objects, lights or materials.
Warnings = defaultdict[str, list[str]]

#: Longer side of textures in pixels; they become colors of triangles.
_SIDE = 1024
_WITH_TEXTURES = ("Base Color", "Emission Color")
_IGNORED = {
    "Subsurface Weight": "Subsurface scattering is ignored",
    "Coat Weight": "Coats are ignored",
    "Sheen Weight": "Sheen is ignored",
    "Anisotropic": "Anisotropy is ignored",
    "Thin Film Thickness": "Thin films are ignored",
}


class Materials:
    """Materials of one scene; `pngs` (image name → PNG file) is a cache for later scenes."""

    def __init__(self, glb: Glb, warnings: Warnings, pngs: dict[str, bytes]) -> None:
        self._glb, self._warnings, self._pngs = glb, warnings, pngs
        self._indices: dict[str, int] = {}
        self._textures: dict[str, int] = {}

    def index(self, material) -> int:
        """Return the index of a `bpy.types.Material`."""
        if material.name_full not in self._indices:
            entry = {"name": material.name, "doubleSided": True} | self._entry(material)
            self._indices[material.name_full] = self._glb.add("materials", entry)
        return self._indices[material.name_full]

    def _entry(self, material) -> dict:
        shader = surface_of(material)
        if shader is not None and shader.type == "BSDF_PRINCIPLED":
            return self._principled(material, shader)
        if shader is not None and shader.type == "EMISSION":
            strength = self._value(material, shader, "Strength")
            return emission(diffuse((0, 0, 0)), self._color(material, shader, "Color"), strength)
        if tree_of(material) is not None:
            self._warnings["Materials without a Principled BSDF have their viewport color"].append(material.name)
        return _surface(material.diffuse_color, material.metallic, material.roughness)

    def _principled(self, material, shader) -> dict:
        value = {name: self._value(material, shader, name) for name in (
            "Metallic", "Roughness", "IOR", "Specular IOR Level", "Emission Strength",
        )}  # fmt: skip
        texture = self._texture(material, shader, "Base Color")
        color = (1, 1, 1) if texture else self._color(material, shader, "Base Color")
        entry = _surface(color, value["Metallic"], value["Roughness"])
        if texture:
            entry["pbrMetallicRoughness"]["baseColorTexture"] = texture
        factor = max(0.0, 2 * value["Specular IOR Level"])  # 0.5 stands for the index of refraction
        tint = [max(0.0, c) * max(factor, 1.0) for c in self._color(material, shader, "Specular Tint")]
        entry["extensions"] = {
            "KHR_materials_specular": {"specularFactor": min(factor, 1.0), "specularColorFactor": tint},
            "KHR_materials_ior": {"ior": max(value["IOR"], 0.0)},
        }
        self._warn(material, shader)
        if value["Emission Strength"] > 0 and (glow := self._texture(material, shader, "Emission Color")):
            return emission(entry, (1, 1, 1), value["Emission Strength"]) | {"emissiveTexture": glow}
        return emission(entry, self._color(material, shader, "Emission Color"), value["Emission Strength"])

    def _warn(self, material, shader) -> None:
        inputs = shader.inputs
        alpha, transmission = constant(inputs["Alpha"]), constant(inputs["Transmission Weight"])
        if alpha is None or alpha < 1 or transmission is None or transmission > 0:
            self._warnings["Transparent materials are opaque"].append(material.name)
        for name, kind in _IGNORED.items():
            if name in inputs and (inputs[name].is_linked or inputs[name].default_value > 0):
                self._warnings[kind].append(material.name)
        if any(name in inputs and inputs[name].is_linked for name in ("Normal", "Coat Normal")):
            self._warnings["Normal and bump maps are ignored"].append(material.name)

    def _value(self, material, shader, name: str) -> float:
        return float(self._constant(material, shader, name)) if name in shader.inputs else 0.0

    def _color(self, material, shader, name: str) -> list[float]:
        return [float(value) for value in self._constant(material, shader, name)][:3]

    def _constant(self, material, shader, name: str):
        if (value := constant(shader.inputs[name])) is not None:
            return value
        if not (name in _WITH_TEXTURES and _is_image(source(shader.inputs[name]))):
            self._warnings["Inputs computed by nodes have their default value"].append(f"{name} of {material.name}")
        return shader.inputs[name].default_value

    def _texture(self, material, shader, name: str) -> dict | None:
        node = source(shader.inputs[name])
        if node is None or not _is_image(node):
            return None
        if (mapping := source(node.inputs["Vector"])) is not None and mapping.type != "UVMAP":
            self._warnings["Textures use the active UV map"].append(f"{name} of {material.name}")
        key = node.image.name_full
        if key not in self._textures:
            if key not in self._pngs:
                self._pngs[key] = _png(node.image)
            self._textures[key] = self._glb.texture(self._pngs[key])
        return {"index": self._textures[key]}


def _is_image(node) -> bool:
    return node.type == "TEX_IMAGE" and node.image is not None and all(node.image.size)


def _png(image) -> bytes:
    """Encode an image data-block, reduced to `_SIDE`."""
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(height, width, image.channels)[::-1]
    step = -(-max(width, height) // _SIDE)
    values = np.mean([values[i : height - step + 1 + i : step, j : width - step + 1 + j : step] for i in range(step)
                      for j in range(step)], axis=0)  # fmt: skip
    rgba = np.ones((*values.shape[:2], 4), np.float32)
    rgba[..., : values.shape[-1]] = values
    if values.shape[-1] < 3:
        rgba[..., :3] = values[..., :1]
    if image.is_float:  # linear; 8-bit images are stored as they are
        linear = np.clip(rgba[..., :3], 0, 1)
        curve = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
        rgba[..., :3] = np.where(linear <= 0.0031308, 12.92 * linear, curve)
    return png((np.clip(rgba, 0, 1) * 255).round().astype(np.uint8))


def diffuse(color) -> dict:
    """Return a material without specular reflection."""
    return _surface(color, 0.0, 1.0) | {"extensions": {"KHR_materials_specular": {"specularFactor": 0.0}}}


def _surface(color, metallic: float, roughness: float) -> dict:
    *rgb, metallic, roughness = (min(max(float(value), 0.0), 1.0) for value in (*color[:3], metallic, roughness))
    pbr = {"baseColorFactor": [*rgb, 1.0], "metallicFactor": metallic, "roughnessFactor": roughness}
    return {"pbrMetallicRoughness": pbr, "extensions": {}}


def emission(entry: dict, color, strength: float) -> dict:
    """Return the material with emitted radiance."""
    radiance = [max(0.0, float(c) * float(strength)) for c in color]
    brightest = max(1.0, *radiance)
    extensions = entry["extensions"] | {"KHR_materials_emissive_strength": {"emissiveStrength": brightest}}
    return entry | {"emissiveFactor": [value / brightest for value in radiance], "extensions": extensions}


def tree_of(owner):
    """Return the node tree of a material, light or world; None if it uses its own settings."""
    return owner.node_tree if getattr(owner, "use_nodes", True) else None  # Blender 6 always uses nodes


def surface_of(owner):
    """Return the node connected to the surface output, or None."""
    tree = tree_of(owner)
    output = None if tree is None else tree.get_output_node("ALL") or tree.get_output_node("CYCLES")
    return None if output is None else source(output.inputs["Surface"])


def source(socket):
    """Return the node that feeds an input, past reroutes; None if the input has its own value."""
    while socket.is_linked and socket.links:
        node = socket.links[0].from_node
        if node.type != "REROUTE":
            return node
        socket = node.inputs[0]
    return None


def constant(socket):
    """Return the value of an input; None if a node computes it."""
    node = source(socket)
    if node is None:
        return socket.default_value
    return node.outputs[0].default_value if node.type in ("VALUE", "RGB") else None
