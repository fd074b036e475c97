import pytest
import torch

from rfpp.radiosity.joint_window import JointWindow

WINDOW = JointWindow(radius=2, reach=1 / 32, normal=0.3, plane=0.01, spread=2.0)


def guides(height: int, width: int, roughness: float = 1.0) -> torch.Tensor:
    """A plane that is seen from straight above, pixel by pixel 0.01 apart."""
    y, x = torch.meshgrid(torch.arange(height) * 0.01, torch.arange(width) * 0.01, indexing="ij")
    plane = torch.stack([0 * x, 0 * x, 1 + 0 * x, x, y, -1 + 0 * x, roughness + 0 * x])
    return plane[None]


def spot(height: int, width: int) -> torch.Tensor:
    light = torch.zeros(1, 6, height, width)
    light[..., height // 2, width // 2] = 1.0
    return light


def test_even_light_stays_even_up_to_the_borders():
    light = torch.full((1, 6, 64, 64), 3.0)
    torch.testing.assert_close(WINDOW(light, guides(64, 64)), light)


def test_neighbors_of_one_surface_share_and_mirrors_do_not():
    dull = WINDOW(spot(64, 64), guides(64, 64))[0]
    assert (dull[:, 30:35, 30:35] > 0).all() and not dull[:, :29].any()
    mirror = WINDOW(spot(64, 64), guides(64, 64, roughness=0.0))[0]
    assert mirror[3:, 32, 32].min() > 0.97 and dull[3:, 32, 32].max() < 0.2
    torch.testing.assert_close(mirror[:3], dull[:3])  # diffuse light is shared whatever the roughness


@pytest.mark.parametrize("apart", ["turned", "farther", "nothing"])
def test_nothing_passes_to_another_surface(apart):
    light, where = torch.zeros(1, 6, 64, 64), guides(64, 64)
    light[..., :32] = 1.0
    if apart == "turned":
        where[:, :3, :, 32:] = torch.tensor([1.0, 0, 0])[None, :, None, None]
    elif apart == "farther":
        where[:, 5, :, 32:] -= 0.2
    else:
        where[..., 32:] = 0.0
    filtered = WINDOW(light, where)
    torch.testing.assert_close(filtered[..., :32], light[..., :32], rtol=0, atol=5e-3)
    assert filtered[..., 32:].max() < 5e-3


def test_finer_images_share_as_far():
    """Noise of single pixels is that much less."""
    noise = {side: torch.rand(1, 6, side, side, generator=torch.Generator().manual_seed(0)) for side in (64, 256)}
    left = {side: WINDOW(light, guides(side, side))[..., 20:44, 20:44].std() for side, light in noise.items()}
    assert left[256] < 0.6 * left[64]
    reach = WINDOW(spot(256, 256), guides(256, 256))[0, 0]
    assert reach[128, 134] > 0 and reach[128, 135] == 0


def test_it_is_linear():
    a, b = (torch.rand(1, 6, 64, 64, generator=torch.Generator().manual_seed(seed)) for seed in (1, 2))
    where = guides(64, 64, 0.5)
    torch.testing.assert_close(WINDOW(a + 2 * b, where), WINDOW(a, where) + 2 * WINDOW(b, where))
