import pytest
import torch

from rfpp.errors import MissingDependencyError
from rfpp.metrics.lpips import LPIPS
from rfpp.metrics.lpips_weights import CONV_CHANNELS, linear_weights


@pytest.fixture(scope="session")
def random_trunk() -> dict[str, torch.Tensor]:
    """A VGG16 of random weights: enough wherever the pretrained ones do not matter."""
    generator = torch.Generator().manual_seed(0)
    trunk = {}
    for name, (inputs, outputs) in CONV_CHANNELS.items():
        scale = (2 / (9 * inputs)) ** 0.5
        trunk[f"{name}.weight"] = scale * torch.randn(outputs, inputs, 3, 3, generator=generator)
        trunk[f"{name}.bias"] = 0.1 * torch.randn(outputs, generator=generator)
    return trunk


@pytest.fixture(scope="session")
def random_lpips(random_trunk) -> LPIPS:
    return LPIPS(random_trunk, linear_weights())


@pytest.fixture(scope="session")
def pretrained_lpips() -> LPIPS:
    try:
        return LPIPS.pretrained()
    except MissingDependencyError as error:
        pytest.skip(str(error))
