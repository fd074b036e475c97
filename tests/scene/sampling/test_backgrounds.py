from collections import Counter

import numpy as np
import pytest
from scene_families import family

from rfpp.errors import SceneError
from rfpp.scene.sampling.backgrounds import KINDS, PANELS, BackgroundSampler, panel_mesh
from rfpp.scene.spec import Material, Scene, SceneObject
from rfpp.scene.triangles import SceneTriangles

SAMPLER = family("quickstart").backgrounds
MATTE = Material(diffuse=(0.5,) * 3, specular=(0.0,) * 3, roughness=1.0)


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(0)
    return [SAMPLER.sample(rng) for _ in range(400)]


def world(background):
    panels = [
        SceneObject(name=str(i), mesh=mesh, material=MATTE, transform=transform)
        for i, (mesh, transform) in enumerate(zip(background.meshes, background.transforms, strict=True))
    ]
    return SceneTriangles.from_scene(Scene(objects=tuple(panels)))


@pytest.mark.parametrize("panel", PANELS)
def test_a_panel_is_a_square_of_128_triangles_that_faces_inside(panel):
    mesh = panel_mesh(panel)
    assert len(mesh) == 128
    assert len(mesh.vertices) == 81
    twice_area = np.cross(mesh.corners[:, 1] - mesh.corners[:, 0], mesh.corners[:, 2] - mesh.corners[:, 0])
    assert np.allclose(twice_area, np.array(PANELS[panel]) * 4 / 64)


def test_all_four_kinds_are_equally_common(drawn):
    counts = Counter(b.kind for b in drawn)
    assert set(counts) == set(KINDS)
    assert min(counts.values()) > 70


def test_the_open_side_is_in_front_of_the_panels_as_they_stand_in_the_world(drawn):
    for background in drawn[:60]:
        triangles = world(background)
        assert len(triangles) == 128 * len(KINDS[background.kind])
        for i, (start, end) in enumerate(zip(triangles.object_offsets, triangles.object_offsets[1:], strict=False)):
            own = background.open_region.distances(triangles.positions[start:end].reshape(-1, 3))[:, i]
            assert own == pytest.approx(0, abs=1e-5)
            facing = triangles.normals[start:end].reshape(-1, 3) @ background.open_region.normals[i]
            assert facing == pytest.approx(1, abs=1e-4)


def test_the_center_of_the_scene_is_well_inside_the_open_side(drawn):
    center = np.random.default_rng(1).uniform(-0.2, 0.2, (200, 3))
    assert min(b.open_region.distances(center).min() for b in drawn) > 0


def test_panels_stay_within_their_ranges(drawn):
    for background in drawn:
        tilt, slide, lift = (0.5, 0.025, (0.01, 0.06)) if background.kind == "box" else (10, 0.025, (0.075, 0.125))
        offset = 0.025 if background.kind == "box" else 0.125
        for panel, transform in zip(KINDS[background.kind], background.transforms, strict=True):
            normal = np.array(PANELS[panel])
            across = np.abs(normal) == 1
            translation, scale = np.array(transform.translation), np.array(transform.scale)
            assert np.abs(transform.rotation).max() <= tilt
            assert np.abs(translation[~across]).max() <= slide
            assert ((scale[~across] >= 0.45) & (scale[~across] <= 0.675)).all()
            low, high = lift if panel == "floor" else (-offset, offset)
            assert low - 1e-9 <= translation @ normal + 0.5 <= high + 1e-9


def test_wrong_weights_are_refused():
    with pytest.raises(SceneError, match="unknown kind 'cave': choose from plane"):
        BackgroundSampler({"cave": 1.0}, SAMPLER.jitter, SAMPLER.box_jitter)
    with pytest.raises(SceneError, match="at least one positive weight"):
        BackgroundSampler({"box": 0.0}, SAMPLER.jitter, SAMPLER.box_jitter)
