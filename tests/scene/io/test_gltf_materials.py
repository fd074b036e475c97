"""glTF: materials as rows, their extensions and textures."""

import math
from pathlib import Path

import numpy as np
import pytest
from gltf_files import SQUARE_UV, GltfBuilder

from rfpp.scene.io.gltf import read_gltf
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR


def material_row(builder_material: dict, folder: Path) -> np.ndarray:
    builder = GltfBuilder()
    builder.node(builder.primitive(material=builder_material))
    return read_gltf(builder.write(folder)).parts[0].material[0]


@pytest.mark.parametrize(
    ("material", "expected"),
    [
        ({}, [0, 0, 0, 1, 1, 1, 1]),
        ({"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.3}}, [0.96] * 3 + [0.04] * 3 + [0.3]),
        (
            {"pbrMetallicRoughness": {"metallicFactor": 0.5, "baseColorFactor": [0.8, 0.4, 0, 1]}},
            [0.384, 0.192, 0, 0.42, 0.22, 0.02, 1],
        ),
        (
            {"pbrMetallicRoughness": {"metallicFactor": 0}, "extensions": {"KHR_materials_ior": {"ior": 2}}},
            [8 / 9] * 3 + [1 / 9] * 3 + [1],
        ),
        (
            {
                "pbrMetallicRoughness": {"metallicFactor": 0},
                "extensions": {"KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [1, 0, 0]}},
            },
            [0.98] * 3 + [0.02, 0, 0] + [1],
        ),
        (
            {
                "extensions": {
                    "KHR_materials_pbrSpecularGlossiness": {
                        "diffuseFactor": [0.5, 0.25, 0, 1],
                        "specularFactor": [0.2, 0.1, 0],
                        "glossinessFactor": 0.7,
                    }
                }
            },
            [0.4, 0.2, 0, 0.2, 0.1, 0, 0.3],
        ),
        ({"pbrMetallicRoughness": {"metallicFactor": 1.00000012, "roughnessFactor": 0.5}}, [0, 0, 0, 1, 1, 1, 0.5]),
    ],
)
def test_materials_are_mapped_as_documented(material: dict, expected: list, tmp_path: Path) -> None:
    np.testing.assert_allclose(material_row(material, tmp_path)[:7], expected, atol=1e-6)


def test_unsupported_extensions_of_materials_are_left_out_with_a_notice(tmp_path: Path) -> None:
    builder = GltfBuilder()
    names = ("sheen", "clearcoat", "ior", "pbrSpecularGlossiness")
    builder.node(builder.primitive(material={"extensions": {f"KHR_materials_{name}": {} for name in names}}))
    with pytest.warns(UserWarning, match="omitted: clearcoat, sheen$"):
        read_gltf(builder.write(tmp_path))


def test_textures_of_specular_and_glossiness_vary_over_the_faces(tmp_path: Path) -> None:
    builder = GltfBuilder()
    positions = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]] * 2)
    uv = np.array([[0.1, 0.1], [0.2, 0.1], [0.1, 0.9], [0.6, 0.1], [0.9, 0.1], [0.6, 0.9]])
    attributes = {"TEXCOORD_0": builder.accessor(uv)}
    shiny = builder.texture(np.array([[[255, 255, 255, 255], [0, 0, 0, 51]]] * 2))
    painted = builder.texture(np.array([[[255, 255, 255, 255], [0, 255, 0, 255]]] * 2))
    glossy = {"specularGlossinessTexture": shiny, "diffuseTexture": painted, "specularFactor": [0.25] * 3}
    material = {"extensions": {"KHR_materials_pbrSpecularGlossiness": glossy}}
    builder.node(builder.primitive(positions, np.arange(6), material, attributes))
    (part,) = read_gltf(builder.write(tmp_path)).parts
    np.testing.assert_allclose(part.material[:, DIFFUSE], [[0.75] * 3, [0, 1, 0]], atol=1e-3)
    np.testing.assert_allclose(part.material[:, SPECULAR], [[0.25] * 3, [0] * 3], atol=1e-3)
    np.testing.assert_allclose(part.material[:, ROUGHNESS][:, 0], [0, 0.8], atol=1e-3)


def test_textures_of_roughness_metal_and_emission_vary_over_the_faces(tmp_path: Path) -> None:
    builder = GltfBuilder()
    # One triangle on the left column of two pixels, one on the right.
    positions = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]] * 2)
    uv = np.array([[0.1, 0.1], [0.2, 0.1], [0.1, 0.9], [0.6, 0.1], [0.9, 0.1], [0.6, 0.9]])
    coordinates = builder.accessor(uv)
    packed = builder.texture(np.array([[[0, 255, 0], [0, 51, 255]]] * 2))
    glow = builder.texture(np.array([[[255, 255, 255], [3, 3, 3]]] * 2))
    material = {
        "pbrMetallicRoughness": {"metallicRoughnessTexture": packed, "roughnessFactor": 0.5},
        "emissiveFactor": [2, 2, 2], "emissiveTexture": glow,
    }  # fmt: skip
    builder.node(builder.primitive(positions, np.arange(6), material, {"TEXCOORD_0": coordinates}))
    (part,) = read_gltf(builder.write(tmp_path)).parts
    np.testing.assert_allclose(part.material[:, ROUGHNESS][:, 0], [0.5, 0.1], atol=1e-3)
    np.testing.assert_allclose(part.material[:, SPECULAR], [[0.04] * 3, [1] * 3], atol=1e-3)
    np.testing.assert_allclose(part.material[:, EMISSION], [[2] * 3, [0] * 3], atol=1e-3)  # faint counts as dark


def test_texture_transforms_choose_the_region_of_their_example(tmp_path: Path) -> None:
    """The extension's own: offset (0, 1), a quarter turn and half size show the lower left quadrant."""
    builder = GltfBuilder()
    uv = {"TEXCOORD_0": builder.accessor(SQUARE_UV)}
    texture = builder.texture(np.array([[[0] * 3, [0] * 3], [[255] * 3, [0] * 3]]))
    texture["extensions"] = {"KHR_texture_transform": {"offset": [0, 1], "rotation": math.pi / 2, "scale": [0.5, 0.5]}}
    material = {"pbrMetallicRoughness": {"metallicFactor": 0, "baseColorTexture": texture}}
    builder.node(builder.primitive(material=material, attributes=uv))
    np.testing.assert_allclose(read_gltf(builder.write(tmp_path)).parts[0].material[:, DIFFUSE], 0.96, atol=1e-6)


def test_cut_outs_lose_their_transparent_faces(tmp_path: Path) -> None:
    builder = GltfBuilder()
    uv = np.array([[0.1, 0.1], [0.2, 0.1], [0.1, 0.2], [0.6, 0.1], [0.9, 0.1], [0.6, 0.2]])
    leaf = builder.texture(np.array([[[9, 200, 9, 255], [9, 200, 9, 0]]]))
    material = {"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorTexture": leaf}}
    positions = np.arange(18).reshape(6, 3) ** 1.5
    attributes = {"TEXCOORD_0": builder.accessor(uv)}
    builder.node(builder.primitive(positions, np.arange(6), material, attributes))
    (part,) = read_gltf(builder.write(tmp_path)).parts
    assert len(part) == 1
    np.testing.assert_allclose(part.vertices[:, 0], positions[:3, 0], rtol=1e-6)
