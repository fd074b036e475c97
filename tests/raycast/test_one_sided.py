"""One-sided emitters: G-buffers, radiosity and Cycles agree on the dark side."""

from dataclasses import replace

import numpy as np
import pytest
from known_scenes import look_at, material, pack, sphere, square
from marks import requires_blender

from rfpp.raycast.first_hit import first_hit
from rfpp.raycast.known_light import with_known_light
from rfpp.raycast.light_sampler import LightSampler
from rfpp.reference.cycles import CyclesSettings, render

POSE, FOV, SIDE = look_at((0.3, -1.5, 0.6), (0, 0, 0.4)), 50.0, 32
#: Name of the light in `known_scenes.pack`.
LIGHT = "object_2"


def scene(one_sided: bool, flipped: bool = False, shape: str = "square"):
    """A floor and a ceiling with a light between them."""
    lamp = square(0.4, z=0.5) if shape == "square" else sphere(0.2, (0, 0, 0.5), 1)
    lamp = lamp[:, ::-1] if flipped else lamp
    whole = pack((square(2), material(0.5)), (square(2, z=1.0), material(0.5)), (lamp, material(0.5, emission=5.0)))
    return replace(whole, one_sided=frozenset([whole.object_names[2]] if one_sided else []))


def direct(triangles, samples: int = 64):
    gbuffer = first_hit(triangles, POSE, FOV, SIDE, SIDE)
    lit = with_known_light(gbuffer, POSE, FOV, LightSampler(triangles), samples).light.diffuse
    return (lit[gbuffer.hit & (gbuffer.triangle < 2)].mean(), lit[gbuffer.triangle >= 2].mean())


@pytest.mark.parametrize("flipped", [False, True])
def test_a_square_lights_the_side_that_it_faces(flipped):
    floor, ceiling = direct(scene(True, flipped))
    both = direct(scene(False, flipped))
    lit, dark, expected = (floor, ceiling, both[0]) if flipped else (ceiling, floor, both[1])
    assert dark == 0
    assert lit == pytest.approx(expected, rel=1e-5)


def test_a_closed_light_with_inward_triangles_is_dark_outside():
    outside, inside = (sum(direct(scene(True, flipped, "sphere"))) for flipped in (False, True))
    assert outside > 0 and inside < 1e-5 * outside  # a ray between two triangles


@requires_blender
def test_it_matches_cycles(in_process):
    triangles = scene(True)
    camera = POSE[None].astype(np.float32), np.float32([FOV])
    settings = CyclesSettings(
        samples=128, adaptive_threshold=0.0, denoise=False, max_bounces=0, diffuse_bounces=0, glossy_bounces=0,
        clamp_direct=0.0, clamp_indirect=0.0, caustics=True, blur_glossy=0.0, light_threshold=0.0, filter_width=0.01,
        seed=0, threads=1,
    )  # fmt: skip
    image = in_process(render, triangles, *camera, SIDE, SIDE, settings)[0]
    gbuffer = first_hit(triangles, POSE, FOV, SIDE, SIDE)
    ours = 0.5 * with_known_light(gbuffer, POSE, FOV, LightSampler(triangles), 256).light.diffuse
    floor = gbuffer.hit & (gbuffer.triangle < 2)
    assert not image[floor].any()
    assert ours.mean() == pytest.approx(image.mean(), rel=0.03)
