"""A VGG16 of random weights: enough wherever LPIPS' pretrained ones do not matter."""

from itertools import pairwise

import torch

from rfpp.metrics.lpips import TRUNK

CHANNELS = (3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512)


def random_trunk() -> dict[str, torch.Tensor]:
    """Weights scaled so that activations neither vanish nor grow, under torchvision's names."""
    generator, trunk = torch.Generator().manual_seed(0), {}
    for i, (inputs, outputs) in enumerate(pairwise(CHANNELS)):
        scale = (2 / (9 * inputs)) ** 0.5
        trunk[TRUNK[2 * i]] = scale * torch.randn(outputs, inputs, 3, 3, generator=generator)
        trunk[TRUNK[2 * i + 1]] = 0.1 * torch.randn(outputs, generator=generator)
    return trunk
