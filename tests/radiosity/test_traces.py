"""What is recorded of rays tells how light changes when what they have met changes its color."""

from dataclasses import replace

import numpy as np
import pytest
from known_scenes import box, look_at, material, pack, square
from slow_light import multiple_scattering

from rfpp.radiosity.cell_finding import cells_at
from rfpp.radiosity.cell_places import find_places
from rfpp.radiosity.pixel_rays import cast_to_cells
from rfpp.raycast.first_hit import first_hit
from rfpp.raycast.ggx import lobe_albedo, scattering_growth
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.scene.triangles import DIFFUSE, SPECULAR, SceneTriangles

FOV, SIDE, POINTS = 40.0, 16, 2
CAMERA = look_at((0.4, -1.4, 0.7), (0, 0, 0.1))
FLOOR, BOX = slice(0, 2), slice(2, 14)


def mirror_and_box(change: float = 0.0, columns: slice = DIFFUSE) -> SceneTriangles:
    """A floor that mirrors a box under a lamp, the box in another color."""
    scene = pack(
        (square(1.2), material(0.2, 0.7, 0.1)),
        (box((0.3, 0.3, 0.3), (0, 0.1, 0.16)), material(0.4, 0.4, 0.4)),
        (square(0.5, z=1.5)[:, ::-1], material(diffuse=1.0, emission=20.0)),
    )
    changed = scene.material.copy()
    changed[BOX, columns] += np.float32(change)
    return replace(scene, material=changed)


def reflected(scene: SceneTriangles):
    seen = first_hit(scene, CAMERA, FOV, SIDE, SIDE, points=POINTS)
    return with_known_light(seen, CAMERA, FOV, LightSampler(scene), 8, traced=True)


@pytest.mark.parametrize("columns", [DIFFUSE, SPECULAR], ids=["diffuse", "specular"])
def test_reflected_light_changes_as_its_trace_says(columns):
    before, more, less = (reflected(mirror_and_box(change, columns)) for change in (0.0, 0.02, -0.02))
    trace, of_floor = before.reflection.trace, before.triangle[before.hit] < FLOOR.stop
    of_box = (trace.triangle >= BOX.start) & (trace.triangle < BOX.stop)
    slope = (trace.diffuse if columns == DIFFUSE else trace.specular) * of_box[..., None]
    found = (more.reflection.light - less.reflection.light)[before.hit] / 0.04
    assert slope[of_floor].sum() > 0
    np.testing.assert_allclose(slope.sum(1)[of_floor], found[of_floor], rtol=5e-3, atol=2e-3 * found.max())


@pytest.mark.parametrize("columns", [DIFFUSE, SPECULAR], ids=["diffuse", "specular"])
def test_bounced_light_changes_as_its_traces_say(columns):
    def of(scene: SceneTriangles):
        sampler = LightSampler(scene)
        places = find_places(scene, sampler.caster)
        cells, sources = cells_at(places, sampler)
        seen = first_hit(scene, CAMERA, FOV, SIDE, SIDE, points=POINTS)
        return cells, cast_to_cells(seen, CAMERA, FOV, sampler, places.map, traced=True), sources

    (cells, pixels, sources), (more, of_more, _), (less, of_less, _) = (
        of(mirror_and_box(change, columns)) for change in (0.0, 0.02, -0.02)
    )
    # of pixels of the floor: how much those of the box blur what they see depends on their own material
    triangle = first_hit(mirror_and_box(), CAMERA, FOV, SIDE, SIDE, points=POINTS).triangle
    of_floor = (triangle >= 0) & (triangle < FLOOR.stop)
    of_floor = of_floor.reshape(SIDE // POINTS, POINTS, SIDE // POINTS, POINTS).all((1, 3)).reshape(-1)
    at_pixels = (of_more.bounced - of_less.bounced).reshape(-1, 3)
    of_cells, every = more.bounced - less.bounced, np.ones(len(cells), bool)
    traces = [(pixels.trace, at_pixels, of_floor)]
    traces.append((sources.bounced, of_cells, every))
    for trace, change, rows in traces:
        of_box = (trace.triangle >= BOX.start) & (trace.triangle < BOX.stop)
        by_albedo = trace.diffuse if columns == DIFFUSE else trace.specular
        slope = (by_albedo * of_box[..., None]).sum(1)[rows].sum(dtype=np.float64)
        assert slope > 0
        assert slope == pytest.approx(change[rows].sum(dtype=np.float64) / 0.04, rel=0.02)
    mean = np.bincount(sources.cell, sources.triangle < FLOOR.stop) / np.bincount(sources.cell)
    np.testing.assert_allclose(cells.diffuse[mean == 1], 0.2, rtol=1e-6)


def test_nothing_is_recorded_and_nothing_changes_where_nobody_asks():
    scene = mirror_and_box()
    seen, sampler = first_hit(scene, CAMERA, FOV, SIDE, SIDE, points=POINTS), LightSampler(scene)
    quiet, traced = (with_known_light(seen, CAMERA, FOV, sampler, 8, traced=wanted) for wanted in (False, True))
    assert quiet.reflection.trace is None
    np.testing.assert_array_equal(quiet.reflection.light, traced.reflection.light)
    places = find_places(sampler.triangles, sampler.caster).map
    assert cast_to_cells(seen, CAMERA, FOV, sampler, places).trace is None


@pytest.mark.parametrize("alpha", [0.01, 0.3, 1.0])
@pytest.mark.parametrize("cosine", [0.2, 0.9])
def test_multiple_scattering_grows_as_its_derivative_says(alpha, cosine):
    tint = np.array([0.2, 0.5, 0.9])
    more, less = (np.log(multiple_scattering(cosine, alpha, tint + h)) for h in (1e-5, -1e-5))
    growth = [scattering_growth(*lobe_albedo(), cosine, alpha, of_one) for of_one in tint]
    np.testing.assert_allclose(growth, (more - less) / 2e-5, rtol=1e-4, atol=1e-6)
    assert scattering_growth(*lobe_albedo(), cosine, alpha, 0.0) == 0
