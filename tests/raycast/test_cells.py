"""Cells: where they are, what they see of each other, and the light that arrives at them."""

from dataclasses import replace

import numpy as np
import pytest
from known_scenes import LIGHT, box, material, moved, pack, rigid_motion, sphere, square, still_life

from rfpp.radiosity.cell_finding import find_cells
from rfpp.radiosity.cell_grid import CellGrid, principal_axes
from rfpp.radiosity.cell_table import NOWHERE
from rfpp.radiosity.cells import Cells
from rfpp.raycast.light_sampler import LightSampler
from rfpp.scene.triangles import EMISSION

LAMP = (LIGHT * 2.5 + [0, 0, 2.0], material(emission=1000.0))


def cells_of(*objects) -> Cells:
    return find_cells(LightSampler(pack(*objects)))[0]


def owners(cells: Cells) -> np.ndarray:
    return cells.octant // 8


def seen(cells: Cells, by: int, what: int) -> float:
    """The share of the light of one object's upper sides that goes to another, by area."""
    rows = (owners(cells) == by) & (cells.normal[:, 2] > 0.5)
    share = (np.append(owners(cells), -1)[cells.hits[rows]] == what).mean(1)
    return float(np.average(share, weights=cells.area[rows]))


def test_squares_that_face_each_other_see_of_each_other_what_the_formula_says():
    cells = cells_of((square(1.0), material(0.5)), (square(1.0, z=1.0), material(0.5)))
    assert seen(cells, by=0, what=1) == pytest.approx(0.1998, abs=0.02)  # Howell's catalogue, C-11, at distance 1


def test_what_stands_in_between_hides():
    floor, roof = (square(0.5), material(0.5)), (square(0.5, z=1.0), material(0.5))
    assert seen(cells_of(floor, roof, (square(2.0, z=0.5), material(0.5))), by=0, what=1) == 0


def test_nothing_is_inside_of_closed_objects_but_what_is_there():
    cells = cells_of((sphere(0.3), material(0.5)), LAMP)
    ball = owners(cells) == 0
    outwards = (cells.normal * cells.centre).sum(-1) > 0
    assert ball.any() and outwards[ball].all()
    within = cells_of((sphere(0.3), material(0.5)), (box(0.1), material(0.9)))
    inwards = (within.normal * within.centre).sum(-1) < 0
    assert (inwards & (owners(within) == 0)).any()  # lit by nothing, but seen by the box


def test_areas_add_up():
    cells = cells_of((sphere(0.3, subdivisions=4), material(0.5)), (square(0.5, z=1.0), material(0.5)))
    ball = owners(cells) == 0
    assert cells.area[ball].sum() == pytest.approx(4 * np.pi * 0.3**2, rel=0.02)
    assert cells.area[~ball].sum() == pytest.approx(0.5, rel=1e-4)  # both sides of a sheet


def test_light_arrives_at_the_side_that_is_lit_and_not_in_shadows():
    cells = cells_of((square(0.5), material(0.5)), (square(0.4, z=-0.3), material(0.5)), LAMP)
    above = (owners(cells) == 0) & (cells.normal[:, 2] > 0)
    assert (cells.arriving[above] > 0).all()
    below = (owners(cells) == 0) & (cells.normal[:, 2] < 0)
    assert not cells.arriving[below].any()
    covered = (owners(cells) == 1) & (cells.normal[:, 2] > 0)
    assert covered.any() and not cells.arriving[covered].any()


def test_light_is_linear_and_the_same_scene_gives_the_same_cells():
    scene = still_life()
    cells, bright = find_cells(LightSampler(scene))[0], scene.material.copy()
    bright[:, EMISSION] *= 3
    lit = find_cells(LightSampler(replace(scene, material=bright)))[0]
    np.testing.assert_allclose(lit.arriving, 3 * cells.arriving, rtol=1e-5)
    np.testing.assert_allclose(lit.highlights, 3 * cells.highlights, rtol=1e-5)
    assert cells.highlights.any()
    for name in ("octant", "hits", "onward", "area", "arriving", "highlights"):
        np.testing.assert_array_equal(
            getattr(find_cells(LightSampler(scene))[0], name), getattr(cells, name), err_msg=name
        )


def test_cells_move_with_their_objects():
    slab, motion = (box(0.4) * [1, 0.7, 0.4] + [0, 0, 0.3], material(0.5)), rigid_motion()
    scene = pack(slab, (square(1.2) * [1, 0.8, 1], material(0.5)), LAMP)
    before, after = find_cells(LightSampler(scene))[0], find_cells(LightSampler(moved(scene, motion)))[0]
    assert abs(len(after) - len(before)) <= 0.03 * len(before)
    carried = before.moved(motion[:3, :3], motion[:3, 3])
    nearest = np.linalg.norm(carried.centre[:, None] - after.centre[None], axis=-1).min(1)
    assert np.median(nearest) < 0.02  # where rays end is drawn anew
    total = lambda cells: (cells.area[:, None] * cells.arriving).sum(0)  # noqa: E731
    np.testing.assert_allclose(total(after), total(before), rtol=0.03)


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


def test_a_point_belongs_to_the_octant_it_lies_in():
    scene = pack((box(0.4) * [1, 0.7, 0.5], material(0.5)))
    cells, _ = find_cells(LightSampler(scene))
    grid = CellGrid.over(scene)
    local = (cells.centre - grid.centroid[0]) @ grid.axes[0].T
    np.testing.assert_array_equal(cells.octant, (local > 0) @ [1, 2, 4])


def test_rays_that_meet_nothing_say_so():
    cells = cells_of((square(0.5), material(0.5)))
    assert (cells.hits == NOWHERE).all()
