"""Preview pictures of samples and scenes."""

import numpy as np
import pytest
from known_scenes import LIGHT, look_at, material, pack, sphere, square, still_life
from stored_sample import stored_sample

from rfpp.imaging import panels
from rfpp.imaging.panels import tone_mapped
from rfpp.raycast.direct_light import direct_radiance
from rfpp.scene.packed import PackedScene
from rfpp.shards.pictures import contact_sheet, sample_panel, with_ambient


@pytest.fixture
def sheets(monkeypatch) -> dict:
    """Captured contents of sheets: columns, captions and title."""
    seen = {}

    def panel(columns, captions, title):
        seen.update(columns=columns, captions=captions, title=title)
        return np.zeros((1, 1, 3), np.uint8)

    def sheet(tiles, captions):
        seen.update(tiles=tiles, captions=captions)
        return np.zeros((1, 1, 3), np.uint8)

    monkeypatch.setattr(panels, "panel", panel)
    monkeypatch.setattr(panels, "contact_sheet", sheet)
    return seen


def test_a_panel_shows_every_view_of_a_sample(sheets):
    sample = stored_sample()
    sample_panel(sample)
    assert {len(tiles) for tiles in sheets["columns"].values()} == {2} == {len(sheets["captions"])}
    assert sheets["title"] == (
        "train-000001: 7 triangles, 2 objects, 1 lights; 3 empty views, 2 scene redraws, 4 unlit views"
    )
    for view, (image, gbuffer) in enumerate(zip(sample.images, sample.gbuffers, strict=True)):
        column = {name: tiles[view] for name, tiles in sheets["columns"].items()}
        np.testing.assert_array_equal(column["image"], tone_mapped(image))
        empty = ~gbuffer.hit
        for name in ("direct light", "albedo", "specular", "normal", "depth (near is bright)", "objects"):
            assert not column[name][empty].any(axis=-1).any() or name.startswith("depth")
            assert column[name][gbuffer.hit].any()


def test_each_object_has_one_color_of_its_own(sheets):
    scene = PackedScene("still life", still_life(), look_at((0.3, -1.5, 0.9))[None], np.array([40.0], np.float32))
    sample = stored_sample(scene)
    sample_panel(sample)
    seen, gbuffer = sheets["columns"]["objects"][0], sample.gbuffers[0]
    ids = np.where(gbuffer.hit, sample.triangles.object_index[gbuffer.triangle], -1)
    colors = {index: np.unique(seen[ids == index], axis=0) for index in np.unique(ids)}
    assert all(len(color) == 1 for color in colors.values())
    assert len({tuple(color[0]) for color in colors.values()}) == len(colors) > 1


def test_direct_radiance_weighs_each_lobe_with_its_albedo():
    sample = stored_sample()
    gbuffer, row = sample.gbuffers[0], sample.triangles.material[sample.gbuffers[0].triangle]
    expected = row[..., 0:3] * gbuffer.light.diffuse + row[..., 3:6] * gbuffer.light.glossy
    seen = gbuffer.hit
    np.testing.assert_allclose(direct_radiance(gbuffer, sample.triangles.material)[seen], expected[seen], rtol=1e-6)
    brighter = direct_radiance(with_ambient(gbuffer, 0.1), sample.triangles.material)
    np.testing.assert_allclose(
        (brighter[seen] - expected[seen]), 0.1 * (row[..., 0:3] + row[..., 3:6])[seen], atol=1e-6
    )
    assert not brighter[~seen].any()


def test_a_contact_sheet_shows_shadows_and_counts(sheets):
    lamp = (np.add(LIGHT, [0, 0, 2]), material(emission=5000.0))
    floor, ball = (square(2.0), material(diffuse=0.8)), (sphere(0.2, (0, 0, 0.5)), material(diffuse=0.8))
    from_the_side = look_at((0, -2.5, 0.25))
    scenes = [
        PackedScene("lit", pack(*things), from_the_side[None], np.array([40.0], np.float32))
        for things in ((floor, lamp), (floor, ball, lamp))
    ]
    contact_sheet(scenes, 64)
    assert sheets["captions"] == ["0: 3 triangles, 1 objects, 1 lights", "1: 1283 triangles, 2 objects, 1 lights"]
    lit, shadowed = (tile[32, 32].astype(int).sum() for tile in sheets["tiles"])
    assert 0 < shadowed < lit / 2


def test_an_unlit_scene_is_shown(sheets):
    dark = still_life()
    dark.material[:, 7:] = 0
    scene = PackedScene("dark", dark, look_at((0.3, -1.5, 0.9))[None], np.array([40.0], np.float32))
    contact_sheet([scene], 16)
    assert sheets["tiles"][0].any()
