"""Textures show on subdivided triangles; cut-outs keep their outline; the budget is kept."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from gltf_files import SQUARE_UV, GltfBuilder
from PIL import Image

from rfpp.scene.io.gltf import read_gltf
from rfpp.scene.io.imported_scene import Part
from rfpp.scene.io.loading import load_scene
from rfpp.scene.triangles import DIFFUSE

#: Left half red, right half in green and black stripes.
PICTURE = np.zeros((64, 64, 3), np.uint8)
PICTURE[:, :32, 0] = 255
PICTURE[::16, 32:, 1] = 255
PICTURE[1::16, 32:, 1] = 255


def read(builder: GltfBuilder, folder: Path, **options) -> tuple[Part, ...]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return read_gltf(builder.write(folder), **options).parts


def card(pixels: np.ndarray, repeats: float = 1.0, node: dict | None = None, **material) -> GltfBuilder:
    """Return a square in the floor with a picture, whose upper left corner is at (-0.5, 0.5)."""
    builder = GltfBuilder()
    uv = {"TEXCOORD_0": builder.accessor(SQUARE_UV * repeats)}
    pbr = {"baseColorTexture": builder.texture(pixels), "metallicFactor": 0, "roughnessFactor": 1}
    builder.node(builder.primitive(material={"pbrMetallicRoughness": pbr, **material}, attributes=uv), **(node or {}))
    return builder


def color_at(part: Part, points: np.ndarray) -> np.ndarray:
    """Return the diffuse albedo [N, 3] at points of a part in the floor; NaN where it has no triangle."""
    a, b, c = np.moveaxis(part.corners[..., :2], 1, 0)
    colors = np.full((len(points), 3), np.nan)
    for number, point in enumerate(points):
        signs = [np.cross(q - p, point - p) for p, q in ((a, b), (b, c), (c, a))]
        inside = np.all(np.stack(signs) >= 0, axis=0) | np.all(np.stack(signs) <= 0, axis=0)
        if inside.any():
            colors[number] = part.material[inside.argmax(), DIFFUSE]
    return colors


POINTS = np.random.default_rng(0).uniform(-0.49, 0.49, (400, 2))


def shown(part: Part, pixels: np.ndarray, repeats: float = 1.0, mirrored: bool = False) -> float:
    """Return the share of points that have the picture's color within a tenth."""
    x, y = POINTS.T
    uv = np.stack([0.5 - x if mirrored else x + 0.5, 0.5 - y]) * repeats % 1.0
    column, row = np.floor(uv * np.array([[pixels.shape[1]], [pixels.shape[0]]])).astype(int)
    expected = pixels[row, column, :3] / 255 * 0.96
    return float((np.abs(color_at(part, POINTS) - expected).max(axis=1) < 0.1).mean())


def test_a_picture_shows_on_two_triangles(tmp_path: Path) -> None:
    (flat,) = read(card(PICTURE), tmp_path, detail=0)
    (part,) = read(card(PICTURE), tmp_path)
    assert len(flat) == 2 and shown(flat, PICTURE) < 0.5
    assert shown(part, PICTURE) > 0.9
    assert 100 < len(part) <= 20_002
    np.testing.assert_allclose(part.areas.sum(), 1)


def test_a_repeated_pattern_is_not_its_mean(tmp_path: Path) -> None:
    """Its quarters have the mean of the whole."""
    checks = np.kron([[255, 0], [0, 255]], np.ones((8, 8)))[..., None].repeat(3, axis=-1)
    (part,) = read(card(checks, repeats=8), tmp_path)
    assert shown(part, checks, repeats=8) > 0.85


def test_mirrored_nodes_show_a_mirrored_picture(tmp_path: Path) -> None:
    (part,) = read(card(PICTURE, node={"scale": [-1, 1, 1]}), tmp_path)
    assert shown(part, PICTURE, mirrored=True) > 0.9


@pytest.mark.parametrize(("detail", "most", "limit"), [(300, None, 302), (5000, 100, 100), (5000, 1, 2)])
def test_no_more_triangles_are_added_than_allowed(detail: int, most: int | None, limit: int, tmp_path: Path) -> None:
    (part,) = read(card(PICTURE), tmp_path, detail=detail, most=most)
    assert limit - 3 < len(part) <= limit


def test_plain_and_uniform_surfaces_stay_whole(tmp_path: Path) -> None:
    (part,) = read(card(np.full((8, 8, 3), 120)), tmp_path)
    assert len(part) == 2 and len(part.vertices) == 4


def leaf() -> np.ndarray:
    """Return a green disk of radius 0.4 before transparency."""
    row, column = (np.mgrid[:128, :128] + 0.5) / 128 - 0.5
    opaque = row**2 + column**2 < 0.4**2
    return np.stack([np.zeros_like(opaque), opaque * 200, np.zeros_like(opaque), opaque * 255], axis=-1)


@pytest.mark.parametrize("mode", ["MASK", "BLEND"])
def test_cut_outs_keep_their_outline(mode: str, tmp_path: Path) -> None:
    (part,) = read(card(leaf(), alphaMode=mode), tmp_path)
    assert part.areas.sum() == pytest.approx(np.pi * 0.4**2, rel=0.03)
    assert np.linalg.norm(part.corners[..., :2], axis=-1).max() < 0.43
    assert part.see_through == ""
    (small,) = read(card(leaf()[:, :16], alphaMode=mode), tmp_path, detail=0)
    assert len(small) == 0 or mode == "BLEND"


def test_glass_with_a_picture_stays_transparent(tmp_path: Path) -> None:
    glass = np.concatenate([PICTURE, np.full((64, 64, 1), 80)], axis=-1)
    (part,) = read(card(glass, alphaMode="BLEND"), tmp_path)
    assert "BLEND" in part.see_through
    assert part.areas.sum() == pytest.approx(1)


@pytest.mark.parametrize(("code", "turned"), [(10497, False), (33648, True)])
def test_samplers_say_what_is_beyond_a_picture(code: int, turned: bool, tmp_path: Path) -> None:
    builder = card(PICTURE, repeats=2.0)
    builder.document["samplers"] = [{"wrapS": code, "wrapT": 33071}]
    builder.document["textures"][0]["sampler"] = 0
    (part,) = read(builder, tmp_path)
    # twice the picture along x: the second time mirrored, or not
    left, right = color_at(part, np.array([[0.1, 0.4], [0.4, 0.4]]))
    assert (left[0] > 0.9, right[0] > 0.9) == (not turned, turned)


def test_a_smooth_surface_is_divided_as_a_whole(tmp_path: Path) -> None:
    ball, builder = trimesh.creation.icosphere(2), GltfBuilder()
    attributes = {
        "NORMAL": builder.accessor(ball.vertices), "TEXCOORD_0": builder.accessor(ball.vertices[:, :2] / 2 + 0.5),
    }  # fmt: skip
    material = {"pbrMetallicRoughness": {"baseColorTexture": builder.texture(PICTURE)}}
    builder.node(builder.primitive(ball.vertices, ball.faces.reshape(-1), material, attributes))
    (part,) = read(builder, tmp_path)
    assert part.smooth
    assert len(part) == 16 * len(ball.faces)


def test_pictures_of_obj_files_show(tmp_path: Path) -> None:
    Image.fromarray(PICTURE).save(tmp_path / "picture.png")
    (tmp_path / "it.mtl").write_text("newmtl it\nKs 0 0 0\nmap_Kd picture.png\n")
    corners = "v -0.5 -0.5 0\nv 0.5 -0.5 0\nv 0.5 0.5 0\nv -0.5 0.5 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n"
    (tmp_path / "it.obj").write_text(f"mtllib it.mtl\n{corners}usemtl it\nf 1/1/1 2/2/1 3/3/1 4/4/1\n")
    with pytest.warns(UserWarning, match=r"textures \(1\) are seen as they are"):
        scene = load_scene(tmp_path / "it.obj", up="z", backdrop="none")
    item = next(item for item in scene.objects if not item.name.endswith("_light"))
    left = item.mesh.vertices[item.mesh.faces][..., 0].max(axis=1) < 1e-9
    assert left.sum() > 0 and (~left).sum() > 100
    np.testing.assert_allclose(item.face_material[left][:, :3], [[1, 0, 0]] * left.sum(), atol=0.05)
