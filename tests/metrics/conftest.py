import pytest
import random_vgg
import torch

from rfpp.metrics.lpips import LPIPS, load_trunk


@pytest.fixture(scope="session")
def random_trunk() -> dict[str, torch.Tensor]:
    return random_vgg.random_trunk()


@pytest.fixture(scope="session")
def random_lpips(random_trunk) -> LPIPS:
    return LPIPS(random_trunk)


@pytest.fixture(scope="session")
def pretrained_lpips() -> LPIPS:
    return LPIPS(load_trunk())
