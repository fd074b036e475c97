"""The light that leaves objects: against the direct light of G-buffers, and by what must make no difference."""

import numpy as np
from known_scenes import LIGHT, box, look_at, material, moved, pack, rigid_motion, sphere, square, still_life

from rfpp.raycast.direct_light import direct_radiance
from rfpp.raycast.first_hit import first_hit
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.raycast.object_light import object_light
from rfpp.scene.triangles import EMISSION, SceneTriangles

LAMP = (LIGHT * 2.5 + [0, 0, 2.0], material(emission=1000.0))


def leaving(*objects) -> np.ndarray:
    return object_light(LightSampler(pack(*objects)))


def test_a_wall_sends_on_what_a_camera_sees_of_it():
    floor = (square(1.0), material(diffuse=(0.8, 0.4, 0.1)))
    scene = pack(floor, (square(0.3, z=0.4), material(0.5)), LAMP)
    above = look_at((0, 0, 0.35), (0, 0, 0), (0, 1, 0))  # below the roof
    fov = float(2 * np.degrees(np.arctan2(0.5, 0.35)))
    seen = with_known_light(first_hit(scene, above, fov, 128, 128), above, fov, LightSampler(scene), 4)
    picture = direct_radiance(seen, scene.material)
    np.testing.assert_allclose(
        leaving(floor, (square(0.3, z=0.4), material(0.5)), LAMP)[0], picture.mean((0, 1)), rtol=0.06
    )


def test_a_sheet_is_lit_wherever_it_is_lit():
    above, below = (square(0.5), material(0.6)), (square(0.5)[:, ::-1], material(0.6))
    np.testing.assert_allclose(leaving(above, LAMP)[0], leaving(below, LAMP)[0], rtol=0.02)
    other = (LAMP[0] * [1, 1, -1], LAMP[1])
    np.testing.assert_allclose(leaving(above, LAMP, other)[0], 2 * leaving(above, LAMP)[0], rtol=0.02)


def test_closed_objects_are_dark_inside_and_what_stands_in_their_shadow_is_dark():
    around, within = (sphere(0.3), material(0.5)), (box(0.1), material(0.9))
    light = leaving(around, within, LAMP)
    assert (light[0] > 0).all() and not light[1].any()
    # a convex body catches, on average over its surface, a quarter of what crosses a surface that faces the lamp
    facing = leaving((square(0.001), material(0.5)), LAMP)[0]
    np.testing.assert_allclose(light[0], facing / 4, rtol=0.1)


def test_glossy_surfaces_send_light_on_too_and_black_ones_do_not():
    dull, shiny = leaving((square(), material(0.5)), LAMP), leaving((square(), material(0.2, specular=0.3)), LAMP)
    np.testing.assert_allclose(shiny, dull, rtol=1e-6)
    assert not leaving((square(), material(0.0)), LAMP).any()


def test_light_is_linear_and_nothing_but_shape_matters():
    scene = still_life()
    light = object_light(LightSampler(scene))
    assert light.shape == (5, 3) and light.dtype == np.float32
    bright = scene.material.copy()
    bright[:, EMISSION] *= 3
    np.testing.assert_allclose(object_light(LightSampler(with_material(scene, bright))), 3 * light, rtol=1e-5)
    np.testing.assert_allclose(object_light(LightSampler(moved(scene, rigid_motion()))), light, rtol=0.02, atol=1e-3)
    np.testing.assert_array_equal(object_light(LightSampler(scene)), light)


def test_each_colour_by_itself():
    scene = still_life()
    swapped = scene.material[:, [2, 0, 1, 5, 3, 4, 6, 9, 7, 8]]
    light = object_light(LightSampler(scene))
    np.testing.assert_allclose(
        object_light(LightSampler(with_material(scene, swapped))), light[:, [2, 0, 1]], rtol=1e-5
    )


def test_without_light_everything_is_dark():
    assert not leaving((square(), material(0.5)), (box(0.2), material(0.5))).any()


def test_an_object_without_surface_sends_nothing_and_disturbs_no_other():
    point = (np.zeros((1, 3, 3)), material(0.5))
    with np.errstate(invalid="ignore"):  # its normal, of the scene
        scene = pack(point, (square(), material(0.5)), LAMP)
    light = object_light(LightSampler(scene))
    assert not light[0].any()
    np.testing.assert_allclose(light[1], leaving((square(), material(0.5)), LAMP)[0], rtol=1e-6)


def with_material(scene: SceneTriangles, rows: np.ndarray) -> SceneTriangles:
    return SceneTriangles(scene.positions, scene.normals, rows, scene.object_offsets, scene.object_names)
