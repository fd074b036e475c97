from collections.abc import Iterable

import numpy as np
import pytest
from known_scenes import box, look_at, material, pack, sphere, square
from slow_light import direct_light

from rfpp.radiosity.cell_places import find_places
from rfpp.radiosity.cell_table import NOWHERE
from rfpp.radiosity.pixel_rays import MOST_RAYS, PixelCells, cast_to_cells
from rfpp.radiosity.ray_ends import follow_rays
from rfpp.raycast.first_hit import first_hit
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.raycast import RayCaster
from rfpp.raycast.surface import Surface
from rfpp.scene.triangles import SceneTriangles

FOV, SIDE = 40.0, 32


def seen_by(
    scene: SceneTriangles, camera: np.ndarray, points: int = 1, seed: int = 0, rays: int = MOST_RAYS
) -> tuple[PixelCells, np.ndarray]:
    """The cells that pixels of a picture see, and the object of each cell, -1 for the last."""
    sampler = LightSampler(scene)
    places = find_places(scene, sampler.caster)
    gbuffer = first_hit(scene, camera, FOV, points * SIDE, points * SIDE, points=points)
    seen = cast_to_cells(gbuffer, camera, FOV, sampler, places.map, rays, seed)
    first = np.searchsorted(places.cell, np.arange(places.cell[-1] + 1))
    return seen, np.append(scene.object_index[places.points.triangle[first]], NOWHERE)


def test_a_floor_sees_of_a_roof_what_the_form_factor_says():
    """From the middle of a square of side 1, a parallel square of side 1 above it at distance 0.5: 0.5541."""
    scene = pack((square(1.0), material(0.5)), (square(1.0, z=0.5), material(0.5)))
    camera, middle = look_at((0, 0, 0.4), (0, 0, 0), (0, 1, 0)), slice(SIDE // 2 - 2, SIDE // 2 + 2)
    drawn = [seen_by(scene, camera, seed=seed) for seed in range(8)]
    shares = [(owner[seen.diffuse] == 1)[middle, middle].mean() for seen, owner in drawn]
    assert np.mean(shares) == pytest.approx(0.5541, abs=0.03)
    seen, owner = drawn[0]
    assert seen.diffuse.shape == (SIDE, SIDE, MOST_RAYS) and set(np.unique(owner[seen.diffuse])) == {NOWHERE, 1}


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
    assert finer.diffuse.shape == (SIDE, SIDE, MOST_RAYS)
    shares = [(owner[cells.diffuse] == 1).mean() for cells in (whole, finer)]
    assert shares[0] == pytest.approx(shares[1], rel=0.15) and shares[0] > 0.01


@pytest.mark.parametrize("rays", [1, 2])
def test_fewer_rays_see_as_much(rays):
    scene = pack((square(1.0), material(0.5, specular=0.3)), (sphere(0.2, (0, 0, 0.3)), material(0.5, specular=0.3)))
    (few, owner), (many, _) = (seen_by(scene, look_at((0, -1.5, 0.8)), rays=n) for n in (rays, MOST_RAYS))
    for name in ("diffuse", "glossy", "diffuse_onward", "glossy_onward"):
        assert getattr(few, name).shape == (SIDE, SIDE, rays)
        # glossy rays are some that their lobe has not absorbed
        shares = [(owner[getattr(seen, name)] == 1).mean() for seen in (few, many)]
        assert shares[0] == pytest.approx(shares[1], rel=0.2, abs=2e-3)


@pytest.mark.parametrize("rays", [1, 2])
def test_fewer_rays_bring_as_much_light(rays):
    camera = look_at((-1.2, 0, 0.4), (0.1, 0, 0))
    few, many = (
        np.mean([seen_by(lit_wall(), camera, seed=seed, rays=n)[0].bounced for seed in range(60)])
        for n in (rays, MOST_RAYS)
    )
    assert few == pytest.approx(many, rel=0.05) and many > 0


def test_pixels_at_an_outline_send_as_many_rays_as_others():
    scene, camera = pack((square(1.0), material(0.5)), (square(200.0, z=0.9), material(0.5))), look_at((0, -1.5, 0.8))
    gbuffer = first_hit(scene, camera, FOV, 2 * SIDE, 2 * SIDE, points=2)
    on_floor = (gbuffer.triangle >= 0) & (gbuffer.triangle < 2)
    hits = on_floor.reshape(SIDE, 2, SIDE, 2).sum((1, 3))
    seen, _ = seen_by(scene, camera, points=2)
    assert ((hits > 0) & (hits < 4)).sum() > SIDE / 2
    assert (seen.diffuse[hits > 0] != NOWHERE).mean() > 0.98


def test_the_same_seed_gives_the_same_rays():
    scene = pack((square(1.0), material(0.5)), (sphere(0.2, (0, 0, 0.3)), material(0.5)))
    first, again, other = (seen_by(scene, look_at((0, -1.5, 0.8)), seed=seed)[0].diffuse for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def above(specular: float, emission: float = 200.0) -> SceneTriangles:
    """A dull floor, a rough surface of the same size over it, and a lamp that lights both from the side."""
    over = (square(1.0, z=0.4), material(0.0, specular=specular, roughness=1.0))
    return pack(
        (square(1.0), material(0.5)), over, (square(0.2) + np.array([1.5, 0, 0.2]), material(emission=emission))
    )


def test_what_a_shiny_surface_throws_on_is_seen_beyond_it():
    """A floor sees itself in what shines above it, and nothing in a surface that does not."""
    camera = look_at((0, 0, 0.3), (0, 0, 0), (0, 1, 0))
    for specular, itself in ((1.0, True), (0.0, False)):
        seen, owner = seen_by(above(specular), camera)
        on_it = owner[seen.diffuse] == 1
        assert (owner[seen.diffuse_onward[on_it]] == 0).any() == itself
        assert (seen.diffuse_onward[~on_it] == NOWHERE).all()


def test_bounced_light_is_linear_in_light_and_of_both_lobes():
    camera = look_at((0, 0, 0.3), (0, 0, 0), (0, 1, 0))
    once, twice, black = (seen_by(above(*of), camera)[0].bounced for of in ((0.8,), (0.8, 400.0), (0.0,)))
    assert once.max() > 0 and not black.any()
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-5)
    assert seen_by(lit_wall(), camera)[0].bounced.max() > 0


def test_what_a_surface_mirrors_itself_does_not_change_what_its_diffuse_rays_bring():
    """Nor do highlights that its glossy lobe would see sharp: the few diffuse rays that meet them would be blots."""
    camera = look_at((0, -1.2, 0.4), (0, 0, 0.1))
    mirror = (sphere(0.2, (0, 0.3, 0.25)), material(0.0, specular=0.9, roughness=0.05))
    lamp = (square(0.1, z=1.5)[:, ::-1], material(emission=2000.0))
    bounced = []
    for specular in (0.0, 0.3):
        scene = pack((square(1.0), material(0.5, specular=specular, roughness=0.3)), mirror, lamp)
        triangle = first_hit(scene, camera, FOV, SIDE, SIDE).triangle
        bounced.append(seen_by(scene, camera)[0].bounced[(triangle >= 0) & (triangle < 2)])
    assert bounced[0].max() > 0
    np.testing.assert_array_equal(*bounced)


WALL = np.array([[[0.5, -0.5, 0], [0.5, 0.5, 1], [0.5, 0.5, 0]], [[0.5, -0.5, 0], [0.5, -0.5, 1], [0.5, 0.5, 1]]])


def lit_wall() -> SceneTriangles:
    """A floor, and a wall beside it, whose foot is in the shadow of a shelf."""
    return pack(
        (square(1.0), material(0.5)),
        (WALL, material(0.8)),
        (square(0.5, z=0.45) + np.array([0.25, 0, 0]), material(0.0)),
        (square(0.3, z=1.5)[:, ::-1], material(emission=30.0)),
    )


def test_bounced_light_knows_shadows_within_a_cell():
    """Irradiance of the floor, from what each point of the wall sends on of the lamp's light."""
    scene, camera, rng = lit_wall(), look_at((-1.2, 0, 0.4), (0.1, 0, 0)), np.random.default_rng(0)
    gbuffer = first_hit(scene, camera, FOV, SIDE, SIDE)
    of_floor = (gbuffer.triangle >= 0) & (gbuffer.triangle < 2)
    seen = np.mean([seen_by(scene, camera, seed=seed)[0].bounced[of_floor].mean() for seed in range(30)])

    along = rng.random((20000, 2))
    place = np.stack([np.full(len(along), 0.5), along[:, 0] - 0.5, along[:, 1]], axis=-1)
    facing = np.tile([-1.0, 0, 0], (len(along), 1))
    wall = Surface.at(scene, np.full(len(along), 2), place, facing, place + facing)
    leaving, arriving = 0.8 * direct_light(scene, wall, 8, rng)[0][:, 0], []
    for point in Surface.at_hits(gbuffer, scene, camera, FOV).point[of_floor[gbuffer.hit]][::7]:
        direction = wall.point - point
        distance = np.linalg.norm(direction, axis=-1)
        direction /= distance[:, None]
        clear = (
            RayCaster(scene.positions).cast(np.broadcast_to(point, direction.shape), direction).distance
            >= distance - 2e-4
        )
        arriving.append(np.mean(leaving * clear * direction[:, 2] * direction[:, 0] / (np.pi * distance**2)))
    assert seen == pytest.approx(np.mean(arriving), rel=0.05)


def lamps(numbers: Iterable[int]) -> SceneTriangles:
    """A floor and a wall under a row of lamps."""
    lamp, shining = square(0.1, z=1.5)[:, ::-1], material(emission=30.0)
    row = [(lamp + np.array([0.1 * n - 0.5, 0, 0]), shining) for n in numbers]
    return pack((square(1.0), material(0.5)), (WALL, material(0.8)), *row)


def test_rays_take_turns_with_many_lights_whose_light_is_still_the_sum_of_theirs():
    camera = look_at((-1.2, 0, 0.4), (0.1, 0, 0))
    many = [seen_by(lamps(range(10)), camera, seed=seed)[0].bounced.sum() for seed in range(12)]
    alone = [[seen_by(lamps([n]), camera, seed=seed)[0].bounced.sum() for n in range(10)] for seed in range(12)]
    assert np.mean(many) == pytest.approx(np.mean(np.sum(alone, axis=1)), rel=0.05)

    scene = lamps(range(10))
    sampler, seen = LightSampler(scene), first_hit(scene, camera, FOV, SIDE, SIDE)
    places = find_places(sampler.triangles, sampler.caster).map
    whole, *parts = (
        cast_to_cells(seen, camera, FOV, of, places).bounced for of in (sampler, *map(sampler.only, sampler.names))
    )
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-3, atol=1e-6)


def test_surfaces_that_touch_are_not_seen_from_where_they_touch():
    """A ray that starts on another surface has no length, and no direction back: its light was NaN."""
    lamp = (square(0.2) + np.array([1.5, 0, 0.5]), material(emission=1))
    sampler = LightSampler(pack((square(1.0), material(0.2, specular=0.9, roughness=1.0)), lamp))
    origin, direction = np.array([[0, 0, 0.0], [0, 0, 0.5]] * 200), np.array([[0, 0, -1.0]] * 400)
    rng = np.random.default_rng(0)
    ends = follow_rays(
        sampler, find_places(sampler.triangles, sampler.caster).map, origin, direction, np.ones(400), rng
    )
    touching, away = ends.light[::2], ends.light[1::2]
    assert not touching.any() and (away > 0).any() and np.isfinite(away).all()
    assert (ends.onward[::2] == NOWHERE).all()
