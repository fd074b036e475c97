"""A VGG16 of random weights: enough wherever LPIPS' pretrained ones do not matter."""

import torch

from rfpp.metrics.lpips_weights import CONV_CHANNELS


def random_trunk() -> dict[str, torch.Tensor]:
    """Weights scaled so that activations neither vanish nor grow, under torchvision's names."""
    generator = torch.Generator().manual_seed(0)
    trunk = {}
    for name, (inputs, outputs) in CONV_CHANNELS.items():
        scale = (2 / (9 * inputs)) ** 0.5
        trunk[f"{name}.weight"] = scale * torch.randn(outputs, inputs, 3, 3, generator=generator)
        trunk[f"{name}.bias"] = 0.1 * torch.randn(outputs, generator=generator)
    return trunk
