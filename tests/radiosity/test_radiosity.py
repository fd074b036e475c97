"""Radiosity against closed forms and a path tracer, and what its filter over pixels may change."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from known_scenes import box, look_at, material, pack, sphere, square
from marks import requires_blender

from rfpp.inference.plan import Plan
from rfpp.inference.radiosity_engine import RadiosityEngine
from rfpp.radiosity.cell_tensors import CellTensors, lit_directly
from rfpp.radiosity.radiosity import Radiosity
from rfpp.radiosity.view import View
from rfpp.reference.cycles import CyclesSettings, render
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import SceneTriangles

FOV, SIDE = 45.0, 32


def cells(diffuse: float, specular: float = 0.0, count: int = 5) -> CellTensors:
    """Cells in a closed room: every ray of each ends in the next."""
    rays = torch.arange(1, count + 1).remainder(count)[:, None].expand(count, 8)
    albedo = torch.ones(count, 3)
    direct = torch.ones(count, 3)
    return CellTensors(diffuse * albedo, specular * albedo, direct, (diffuse + specular) * direct, rays, rays)


@pytest.mark.parametrize("albedo", [0.0, 0.5, 0.8])
def test_light_in_a_closed_room_is_a_geometric_series(albedo):
    for lit, bounces in zip(Radiosity().solve(cells(albedo), 4), range(5), strict=True):
        expected = sum(albedo**k for k in range(1, bounces + 1))
        torch.testing.assert_close(lit.indirect, torch.full((5, 3), float(expected)))


@pytest.mark.parametrize("albedo", [0.5, 0.8, 0.95])
def test_it_takes_as_many_bounces_as_the_room_needs(albedo):
    expected = albedo / (1 - albedo)
    torch.testing.assert_close(Radiosity().solve(cells(albedo))[-1].indirect.mean().item(), expected, rtol=0.03, atol=0)


def test_energy_never_grows():
    bright = replace(cells(0.9, 0.9).conserving(), bounced=torch.ones(5, 3))
    torch.testing.assert_close(bright.diffuse + bright.specular, torch.ones(5, 3))
    states = Radiosity().solve(bright, 6)
    growth = [b.indirect.mean() - a.indirect.mean() for a, b in pairwise(states)]
    assert all(step <= 1 + 1e-5 for step in growth)


def test_rays_that_escape_bring_nothing():
    dark = replace(cells(0.8), hits=torch.full((5, 8), 5), onward=torch.full((5, 8), 5))
    assert torch.equal(Radiosity().solve(dark, 3)[-1].indirect, dark.bounced)


def plane(roughness: float, reflected: torch.Tensor, points: int) -> View:
    """A specular plane seen from straight above, which reflects [3, H, W] light."""
    side = reflected.shape[-1]
    y, x = torch.meshgrid(torch.arange(side) * 0.01 / points, torch.arange(side) * 0.01 / points, indexing="ij")
    dark, escaped = torch.zeros(3, side, side), torch.full((1, side // points, side // points), 5)
    channels = {
        "albedo": dark,
        "specular": dark + 1,
        "roughness": torch.full((1, side, side), roughness),
        "normal": torch.stack([0 * x, 0 * x, 0 * x + 1]),
        "position": torch.stack([x, y, -torch.ones_like(x)]),
        "direct_diffuse": dark,
        "direct_glossy": dark,
        "reflected_light": reflected,
    }
    bounced = torch.zeros(3, side // points, side // points)
    return View(channels, escaped, escaped, escaped, escaped, bounced, FOV, points)


def image(roughness: float, reflected: torch.Tensor, points: int) -> torch.Tensor:
    return Radiosity().render(lit_directly(cells(0.5)), plane(roughness, reflected, points))


def noise(points: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(3, 48 * points, 48 * points, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("points", [1, 2])
def test_reflections_lose_grain_on_rough_surfaces_and_keep_detail_in_mirrors(points):
    grain = noise(points)
    deviation = {roughness: image(roughness, grain, points).std() for roughness in (0.0, 0.5, 1.0)}
    assert deviation[1.0] < 0.4 * deviation[0.0]
    assert deviation[1.0] < deviation[0.5] < 0.9 * deviation[0.0]


@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
def test_even_light_stays_as_it_is(roughness):
    even = torch.full_like(noise(2), 3.0)
    torch.testing.assert_close(image(roughness, even, 2), torch.full((3, 48, 48), 3.0))


def test_an_image_is_linear_in_light():
    a, b = noise(1, seed=1), noise(1, seed=2)
    torch.testing.assert_close(image(0.6, a + 2 * b, 1), image(0.6, a, 1) + 2 * image(0.6, b, 1))


def room(specular: float) -> SceneTriangles:
    """A floor and two walls, a box and a ball, with this share of the albedo specular."""
    surface = lambda gray, roughness: material((1 - specular) * gray, specular * gray, roughness)  # noqa: E731
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
@pytest.mark.parametrize("specular", [0.0, 0.7], ids=["diffuse", "glossy"])
def test_each_bounce_matches_a_path_tracer(specular, in_process):
    triangles, camera = room(specular), look_at((0.7, -1.3, 0.9), (0, 0, 0.25))[None].astype(np.float32)
    scene = PackedScene("room", triangles, camera, np.float32([FOV]))
    engine = RadiosityEngine(Radiosity(), torch.device("cpu"), torch.float32)

    def reference(bounces: int) -> float:
        return in_process(render, triangles, camera, scene.fov, SIDE, SIDE, settings(bounces)).mean()

    direct = reference(0)
    [bounces] = engine.bounces(Plan(scene, (SIDE, SIDE), 64, 2, 3))
    ours = np.cumsum(bounces.mean((1, 2, 3)))
    for number in (1, 2, 3, 4):
        assert ours[number] - ours[0] == pytest.approx(reference(number) - direct, rel=0.1)


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
        blur_glossy=0.1,
        light_threshold=0.0,
        filter_width=1.5,
        seed=0,
        threads=0,
    )
