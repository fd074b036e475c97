"""What shiny surfaces reflect: grain of dull ones is shared, images in mirrors stay sharp, and no light is lost."""

import pytest
import torch

from rfpp.radiosity.joint_window import JointWindow
from rfpp.model.linear_decoder import KNOWN, radiance_with
from rfpp.model.view_channels import ViewChannels

SIDE = 48
NAMES = (*KNOWN, "roughness", "normal", "position")


def plane(roughness: float, reflected: torch.Tensor, points: int) -> ViewChannels:
    """A specular plane seen from straight above, which reflects [1, 3, H, W] light."""
    side = SIDE * points
    y, x = torch.meshgrid(torch.arange(side) * 0.01 / points, torch.arange(side) * 0.01 / points, indexing="ij")
    even, nothing = torch.ones(1, 3, side, side), torch.zeros(1, 3, side, side)
    position = torch.stack([x, y, -torch.ones_like(x)])[None]
    normal = torch.stack([0 * x, 0 * x, 0 * x + 1])[None]
    rough = torch.full((1, 1, side, side), roughness)
    light = torch.cat([nothing, even, nothing, nothing, reflected, rough, normal, position], dim=1)
    return ViewChannels(light, NAMES, torch.ones(1))


def image(roughness: float, reflected: torch.Tensor, points: int) -> torch.Tensor:
    of_points, window = plane(roughness, reflected, points), JointWindow()
    guides = of_points.pooled(points).linear(window.channels)
    return radiance_with(lambda shared: window(torch.cat([0 * shared, shared], dim=1), guides), of_points, points)


def noise(points: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(1, 3, SIDE * points, SIDE * points, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("points", [1, 2])
def test_grain_goes_from_dull_surfaces_and_detail_stays_in_mirrors(points):
    grain = noise(points)
    as_it_is = torch.nn.functional.avg_pool2d(grain, points)
    left = {roughness: image(roughness, grain, points).std() / as_it_is.std() for roughness in (0.0, 0.5, 1.0)}
    assert left[1.0] < 0.3
    assert left[1.0] < left[0.5] < 0.85
    torch.testing.assert_close(image(0.0, grain, points), as_it_is)


@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
def test_even_light_stays_what_it_is(roughness):
    torch.testing.assert_close(image(roughness, torch.full_like(noise(2), 3.0), 2), torch.full((1, 3, SIDE, SIDE), 3.0))


def test_it_is_linear():
    a, b = noise(1, seed=1), noise(1, seed=2)
    torch.testing.assert_close(image(0.6, a + 2 * b, 1), image(0.6, a, 1) + 2 * image(0.6, b, 1))
