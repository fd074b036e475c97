"""Cells: where they are, what they see of each other, and the light that arrives at them."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from known_scenes import LIGHT, box, material, moved, pack, rigid_motion, sphere, square, still_life

from rfpp.radiosity import cell_grid
from rfpp.radiosity.cell_finding import cells_at
from rfpp.radiosity.cell_grid import principal_axes
from rfpp.radiosity.cell_places import find_places
from rfpp.radiosity.cell_table import NOWHERE
from rfpp.radiosity.cells import Cells
from rfpp.raycast.light_sampler import LightSampler
from rfpp.scene.triangles import EMISSION, SceneTriangles

LAMP = (LIGHT * 2.5 + [0, 0, 2.0], material(emission=1000.0))


class Placed:
    """The cells of a scene with owner, mean normal and center of each."""

    def __init__(self, triangles: SceneTriangles):
        sampler = LightSampler(triangles)
        places = find_places(triangles, sampler.caster)
        self.cells: Cells = cells_at(places, sampler)[0]
        first = np.searchsorted(places.cell, np.arange(len(self.cells)))
        self.owner = triangles.object_index[places.points.triangle[first]]
        count = np.bincount(places.cell)[:, None]
        self.normal, self.center = (
            np.stack([np.bincount(places.cell, axis) for axis in values.T], axis=-1) / count
            for values in (places.normal, places.points.position)
        )


def cells_of(*objects) -> Placed:
    return Placed(pack(*objects))


def seen(placed: Placed, by: int, what: int) -> float:
    """The share of the light of one object's upper sides that goes to another."""
    rows = (placed.owner == by) & (placed.normal[:, 2] > 0.5)
    return float((np.append(placed.owner, -1)[placed.cells.hits[rows]] == what).mean())


def test_squares_that_face_each_other_see_of_each_other_what_the_formula_says():
    cells = cells_of((square(1.0), material(0.5)), (square(1.0, z=1.0), material(0.5)))
    assert seen(cells, by=0, what=1) == pytest.approx(0.1998, abs=0.02)  # Howell's catalogue, C-11, at distance 1


def test_what_stands_in_between_hides():
    floor, roof = (square(0.5), material(0.5)), (square(0.5, z=1.0), material(0.5))
    assert seen(cells_of(floor, roof, (square(2.0, z=0.5), material(0.5))), by=0, what=1) == 0


def test_nothing_is_inside_of_closed_objects_but_what_is_there():
    cells = cells_of((sphere(0.3), material(0.5)), LAMP)
    ball = cells.owner == 0
    outwards = (cells.normal * cells.center).sum(-1) > 0
    assert ball.any() and outwards[ball].all()
    within = cells_of((sphere(0.3), material(0.5)), (box(0.1), material(0.9)))
    inwards = (within.normal * within.center).sum(-1) < 0
    assert (inwards & (within.owner == 0)).any()  # lit by nothing, but seen by the box


def test_light_arrives_at_the_side_that_is_lit_and_not_in_shadows():
    placed = cells_of((square(0.5), material(0.5)), (square(0.4, z=-0.3), material(0.5)), LAMP)
    direct, upwards = placed.cells.direct, placed.normal[:, 2]
    assert (direct[(placed.owner == 0) & (upwards > 0)] > 0).all()
    assert not direct[(placed.owner == 0) & (upwards < 0)].any()
    covered = (placed.owner == 1) & (upwards > 0)
    assert covered.any() and not direct[covered].any()


def test_small_objects_of_a_crowd_are_one_cell_each_and_the_rest_is_as_before(monkeypatch):
    grid = [(x, y) for x in np.linspace(-0.4, 0.4, 9) for y in np.linspace(-0.4, 0.4, 9)]
    boxes = [(box(0.03, (x, y, 0.1)), material(0.6)) for x, y in grid]
    scene = pack((square(0.5), material(0.5)), *boxes, LAMP)
    alone = Placed(scene)
    monkeypatch.setattr(cell_grid, "CROWD", 80)
    crowded = Placed(scene)
    counts = [np.bincount(placed.owner) for placed in (alone, crowded)]
    assert (counts[1][1:82] == 1).all() and (counts[0][1:82] >= 6).all()  # insides are not reached
    assert counts[0][0] == counts[1][0] and counts[0][82] == counts[1][82]
    floor = [placed.cells.bounced[placed.owner == 0].mean() for placed in (alone, crowded)]
    assert floor[1] == pytest.approx(floor[0], rel=0.25)  # few rays hit a box: 10% of noise


def test_finer_triangles_make_no_more_cells():
    """The time of light between surfaces does not grow with the triangles of a scan."""
    counts = []
    for subdivisions in (4, 6):
        ball = np.add(trimesh.creation.icosphere(subdivisions, 0.4).triangles, (0, 0, 0.5))
        triangles = pack((ball, material(0.5)), (square(1.2), material(0.5)), LAMP)
        places = find_places(triangles, LightSampler(triangles).caster)
        counts.append((len(places.cell), places.cell.max() + 1))
    np.testing.assert_allclose(counts[1], counts[0], rtol=0.05)


def test_light_is_linear_and_the_same_scene_gives_the_same_cells():
    scene = still_life()
    cells, bright = Placed(scene).cells, scene.material.copy()
    bright[:, EMISSION] *= 3
    lit = Placed(replace(scene, material=bright)).cells
    np.testing.assert_allclose(lit.direct, 3 * cells.direct, rtol=1e-5)
    np.testing.assert_allclose(lit.bounced, 3 * cells.bounced, rtol=1e-5)
    assert cells.bounced.any()
    for name in ("hits", "onward", "direct", "bounced"):
        np.testing.assert_array_equal(getattr(Placed(scene).cells, name), getattr(cells, name), err_msg=name)


def test_cells_move_with_their_objects():
    slab, motion = (box(0.4) * [1, 0.7, 0.4] + [0, 0, 0.3], material(0.5)), rigid_motion()
    scene = pack(slab, (square(1.2) * [1, 0.8, 1], material(0.5)), LAMP)
    before, after = Placed(scene), Placed(moved(scene, motion))
    assert abs(len(after.cells) - len(before.cells)) <= 0.03 * len(before.cells)
    carried = before.center @ motion[:3, :3].T + motion[:3, 3]
    nearest = np.linalg.norm(carried[:, None] - after.center[None], axis=-1).min(1)
    assert np.median(nearest) < 0.02  # ends of rays are drawn anew
    np.testing.assert_allclose(after.cells.direct.mean(0), before.cells.direct.mean(0), rtol=0.04)


@pytest.mark.parametrize("shape", [square(0.5), box(0.2), box(0.4) * [1, 0.7, 0.4], sphere(0.3)])
def test_axes_turn_with_their_object_and_not_with_rounding(shape):
    turn, corners = rigid_motion()[:3, :3], shape.astype(np.float64)
    _, axes = principal_axes(corners)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    _, turned = principal_axes(corners @ turn.T)
    np.testing.assert_allclose(turned @ turn, axes, atol=1e-4)
    for seed in range(20):  # as another processor's rounding would
        noise = np.random.default_rng(seed).normal(scale=1e-9, size=corners.shape)
        np.testing.assert_allclose(principal_axes(corners + noise)[1], axes, atol=1e-4)


def test_rays_that_meet_nothing_say_so():
    cells = cells_of((square(0.5), material(0.5)))
    assert (cells.cells.hits == NOWHERE).all()
