"""The cells that pixels see: rays go where light comes from."""

import numpy as np
import pytest
from known_scenes import box, look_at, material, pack, sphere, square

from rfpp.gbuffer.cell_finding import find_cells
from rfpp.gbuffer.cells import NOWHERE
from rfpp.gbuffer.first_hit import CELL_RAYS, SeenCells, first_hit
from rfpp.gbuffer.gathering import with_cells
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.scene.triangles import SceneTriangles

FOV, SIDE = 40.0, 32


def seen_by(scene: SceneTriangles, camera: np.ndarray, points: int = 1, seed: int = 0) -> tuple[SeenCells, np.ndarray]:
    """The cells that pixels of a picture see, and the object of each cell, -1 for the last."""
    sampler = LightSampler(scene)
    cells, places = find_cells(sampler)
    gbuffer = first_hit(scene, camera, FOV, points * SIDE, points * SIDE)
    seen = with_cells(gbuffer, camera, FOV, scene, sampler.caster, places, points, seed).cells
    return seen, np.append(cells.octant // 8, NOWHERE)


def test_a_floor_sees_of_a_roof_what_the_form_factor_says():
    """From the middle of a square of side 1, a parallel square of side 1 above it at distance 0.5: 0.5541."""
    scene = pack((square(1.0), material(0.5)), (square(1.0, z=0.5), material(0.5)))
    camera, middle = look_at((0, 0, 0.4), (0, 0, 0), (0, 1, 0)), slice(SIDE // 2 - 2, SIDE // 2 + 2)
    drawn = [seen_by(scene, camera, seed=seed) for seed in range(8)]
    shares = [(owner[seen.diffuse] == 1)[middle, middle].mean() for seen, owner in drawn]
    assert np.mean(shares) == pytest.approx(0.5541, abs=0.03)
    seen, owner = drawn[0]
    assert seen.diffuse.shape == (SIDE, SIDE, CELL_RAYS) and set(np.unique(owner[seen.diffuse])) == {NOWHERE, 1}


def test_a_mirror_sees_what_is_mirrored_and_dull_surfaces_have_no_glossy_rays():
    mirror = (square(2.0), material(0.0, specular=1.0, roughness=0.0))
    wall = (np.array([[[-2, 1, 0], [2, 1, 0], [2, 1, 4]], [[-2, 1, 0], [2, 1, 4], [-2, 1, 4]]], float), material(0.5))
    scene = pack(mirror, wall)
    seen, owner = seen_by(scene, look_at((0, -1, 1), (0, 0, 0)))
    gbuffer = first_hit(scene, look_at((0, -1, 1), (0, 0, 0)), FOV, SIDE, SIDE)
    on_mirror, on_wall = gbuffer.hit & (gbuffer.triangle < 2), gbuffer.hit & (gbuffer.triangle >= 2)
    assert on_mirror.any() and (owner[seen.glossy[on_mirror]] == 1).all()
    assert not on_wall.any() or (seen.glossy[on_wall] == NOWHERE).all()


def test_nothing_is_seen_where_nothing_is():
    seen, _ = seen_by(pack((box(0.3), material(0.5))), look_at((0, -2, 0.5)))
    gbuffer = first_hit(pack((box(0.3), material(0.5))), look_at((0, -2, 0.5)), FOV, SIDE, SIDE)
    assert (seen.diffuse[~gbuffer.hit] == NOWHERE).all() and (seen.diffuse[gbuffer.hit] == NOWHERE).all()


def test_points_of_a_pixel_share_its_rays():
    scene = pack((square(1.0), material(0.5)), (sphere(0.2, (0, 0, 0.3)), material(0.5, specular=0.3)))
    camera = look_at((0, -1.5, 0.8))
    whole, owner = seen_by(scene, camera)
    finer, _ = seen_by(scene, camera, points=2)
    assert finer.diffuse.shape == (2 * SIDE, 2 * SIDE, CELL_RAYS)
    for lobe in (finer.diffuse, finer.glossy):
        np.testing.assert_array_equal(lobe[::2, ::2], lobe[1::2, 1::2])
    shares = [(owner[cells.diffuse] == 1).mean() for cells in (whole, finer)]
    assert shares[0] == pytest.approx(shares[1], rel=0.15) and shares[0] > 0.01


def test_the_same_seed_gives_the_same_rays():
    scene = pack((square(1.0), material(0.5)), (sphere(0.2, (0, 0, 0.3)), material(0.5)))
    first, again, other = (seen_by(scene, look_at((0, -1.5, 0.8)), seed=seed)[0].diffuse for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
