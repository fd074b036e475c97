import pytest
import random_vgg
import torch

from rfpp.errors import MissingDependencyError
from rfpp.metrics.lpips import LPIPS
from rfpp.metrics.lpips_weights import linear_weights


@pytest.fixture(scope="session")
def random_trunk() -> dict[str, torch.Tensor]:
    return random_vgg.random_trunk()


@pytest.fixture(scope="session")
def random_lpips(random_trunk) -> LPIPS:
    return LPIPS(random_trunk, linear_weights())


@pytest.fixture(scope="session")
def pretrained_lpips() -> LPIPS:
    try:
        return LPIPS.pretrained()
    except MissingDependencyError as error:
        pytest.skip(str(error))
