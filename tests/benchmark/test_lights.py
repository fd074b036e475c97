"""The benchmark of lights: what its scenes are, and that one small light sends out as much as those it replaces."""

import numpy as np
import pytest
from networks import checkpoint_info, network

from rfpp.benchmark import lights
from rfpp.benchmark.exhibits import SceneFile
from rfpp.benchmark.lights import Coated, Relit, measure, with_one_small_light
from rfpp.benchmark.textured import Textured, picture
from rfpp.inference.renderer import Renderer
from rfpp.scene.io.image_texture import linear
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR, SceneTriangles

STORED = SceneFile("box", "data/scenes/cornell_box.json")


def power(triangles: SceneTriangles) -> np.ndarray:
    a, b, c = np.moveaxis(triangles.positions, 1, 0)
    return (np.linalg.norm(np.cross(b - a, c - a), axis=1)[:, None] / 2 * triangles.material[:, EMISSION]).sum(axis=0)


def test_emitters_are_replaced_by_as_much_light() -> None:
    scene = STORED.scene()
    for relit, count, emitting in (
        (Relit("", STORED, 8, 8).scene(), 8, 64),
        (Relit("", STORED, 1, 2000).scene(), 1, 2000),
        (with_one_small_light(scene), 1, 1),
    ):
        triangles = relit.triangles
        assert (triangles.num_lights, triangles.is_emissive.sum()) == (count, emitting)
        np.testing.assert_allclose(power(triangles), power(scene.triangles), rtol=1e-4)
        surfaces = scene.triangles.positions[~scene.triangles.is_emissive]
        np.testing.assert_array_equal(triangles.positions[~triangles.is_emissive], surfaces)
        assert triangles.object_offsets[-1] == len(triangles)


def test_coats_leave_the_lights_alone() -> None:
    before = STORED.scene().triangles
    mirrors, textured = (Coated("", STORED, mirrors).scene().triangles.material for mirrors in (True, False))
    np.testing.assert_array_equal(mirrors[before.is_emissive], before.material[before.is_emissive])
    surface = ~before.is_emissive
    assert not mirrors[surface, DIFFUSE].any() and not mirrors[surface, ROUGHNESS].any()
    assert (mirrors[surface, SPECULAR] == np.float32(0.9)).all()
    assert len(np.unique(textured[surface], axis=0)) == surface.sum()


@pytest.mark.parametrize("pixels", [64, None])
def test_a_textured_scene_is_the_stored_one_with_another_colour(pixels) -> None:
    before, after = STORED.scene(), Textured("", STORED, pixels).scene()
    old, new = before.triangles, after.triangles
    np.testing.assert_allclose(after.c2w, before.c2w, atol=1e-5)
    np.testing.assert_allclose(after.fov, before.fov, rtol=1e-5)
    assert new.object_names == old.object_names and new.num_lights == old.num_lights
    np.testing.assert_allclose(new.positions, old.positions, atol=1e-6)
    np.testing.assert_allclose(new.normals, old.normals, atol=0.02)
    np.testing.assert_allclose(new.material[:, EMISSION], old.material[:, EMISSION], rtol=1e-5)
    surface = ~old.is_emissive
    np.testing.assert_allclose(new.material[surface, ROUGHNESS], old.material[surface, ROUGHNESS], atol=1e-5)
    colours, shown = new.material[surface, DIFFUSE], linear(picture(64)).reshape(-1, 3)
    assert (colours <= shown.max(axis=0)).all() and (colours >= 0.9 * shown.min(axis=0)).all()
    assert len(np.unique(colours.round(3), axis=0)) == 1 if pixels is None else len(np.unique(colours, axis=0)) > 100


def test_a_row_compares_a_scene_with_one_small_light(monkeypatch) -> None:
    monkeypatch.setattr(lights.Renderer, "load", lambda _: Renderer(network(), checkpoint_info()))
    done = []
    (row,) = measure("small", [Relit("many", STORED, 8, 8)], 16, 1, lambda *n: done.append(n))
    assert (row["scene"], row["lights"], row["emitting"]) == ("many", 8, 64)
    assert row["read_s"] > 0
    assert row["ratio"] == pytest.approx(row["first_s"] / row["one_light_s"])
    assert done == [(1, 1)]
