"""Light of one to four bounces between cells is what a path tracer finds, on dull and on shiny surfaces."""

import numpy as np
import pytest
from known_scenes import box, look_at, material, pack, sphere, square
from marks import requires_blender

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.imaging.radiance import log_decode
from rfpp.inference.gbuffers import GBufferSource
from rfpp.model.radiosity import UnlearnedRadiosity
from rfpp.reference.cycles import CyclesSettings, render
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import SceneTriangles

FOV, SIDE = 45.0, 32


def room(specular: float) -> SceneTriangles:
    """A floor and two walls, a box and a ball, of which so large a share of the albedo shines."""
    surface = lambda grey, roughness: material((1 - specular) * grey, specular * grey, roughness)  # noqa: E731
    lamp = square(0.3, z=1.6)[:, ::-1] + np.array([0.1, -0.5, 0])
    return pack(
        (square(1.2), surface(0.8, 0.4)),
        (square(1.2)[..., [0, 2, 1]] + np.array([0, 0.5, 0.5]), surface(0.7, 0.6)),
        (square(1.2)[..., [2, 1, 0]] + np.array([-0.5, 0, 0.5]), surface(0.8, 0.3)),
        (box((0.3, 0.3, 0.5), (0.2, 0.1, 0.26)), surface(0.9, 0.5)),
        (sphere(0.15, (-0.1, -0.2, 0.16)), surface(0.9, 0.3)),
        (lamp, material(diffuse=1.0, emission=20.0)),
    )


@requires_blender
@pytest.mark.parametrize("specular", [0.0, 0.7], ids=["dull", "shiny"])
def test_every_bounce_is_that_of_a_path_tracer(specular, in_process):
    triangles, camera = room(specular), look_at((0.7, -1.3, 0.9), (0, 0, 0.25))[None].astype(np.float32)
    scene = PackedScene("room", triangles, camera, np.float32([FOV]))
    radiosity = UnlearnedRadiosity()
    source = GBufferSource(radiosity.gbuffer_channels)
    gbuffer = source.of(scene, SIDE, SIDE, 64, points=2)(0)[None]
    known = source.known_of_scene(triangles, ("object_light", "cells"))
    views = SceneViews("room", triangles, camera, scene.fov, gbuffer, None, **known)

    def theirs(bounces: int) -> float:
        return in_process(render, triangles, camera, scene.fov, SIDE, SIDE, settings(bounces)).mean()

    direct = theirs(0)
    for bounces in (1, 2, 3, 4):
        radiosity.iterations = bounces - 1  # from cells to pixels is the last
        ours = log_decode(radiosity(RaggedBatch.pack([views]), 2).log_radiance).mean().item()
        assert ours - direct == pytest.approx(theirs(bounces) - direct, rel=0.1)


def settings(bounces: int) -> CyclesSettings:
    return CyclesSettings(
        samples=256,
        adaptive_threshold=0.0,
        denoise=False,
        max_bounces=bounces,
        diffuse_bounces=bounces,
        glossy_bounces=bounces,
        clamp_direct=0.0,
        clamp_indirect=0.0,
        caustics=True,
        blur_glossy=1.0,
        light_threshold=0.0,
        filter_width=1.5,
        seed=0,
        threads=0,
    )
