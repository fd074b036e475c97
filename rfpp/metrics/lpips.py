"""LPIPS (Zhang et al., CVPR 2018) with the VGG16 trunk, in plain torch.

Equal to the `lpips` package with version 0.1 of its linear weights, but without torchvision. It is not an `nn.Module`:
its weights must not become parameters or buffers of a checkpoint, optimizer or distributed wrapper, and must keep their
precision when a module is cast.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from rfpp.metrics.lpips_weights import CONV_CHANNELS, linear_weights, trunk_weights

#: Convolutions of each VGG16 stage. Stages are separated by 2x2 max pooling; LPIPS reads the end of each.
STAGES = (2, 2, 3, 3, 3)
#: Pixels per side that four poolings and a last convolution need.
MIN_SIZE = 16

_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
_NORM_EPS = 1e-10


class LPIPS:
    """Learned perceptual distance between images, differentiable in both and computed in float32.

    Args:
        trunk: VGG16 convolutions by torchvision's names (`trunk_weights()`).
        linear: Channel weights of the five stages, [C] each (`linear_weights()`).

    Example:
        lpips = LPIPS.pretrained()
        distance = lpips(a, b)  # a, b [N, 3, H, W] in [-1, 1] -> [N]
    """

    def __init__(self, trunk: Mapping[str, Tensor], linear: list[Tensor]) -> None:
        names = list(CONV_CHANNELS)
        convolutions = [(trunk[f"{name}.weight"], trunk[f"{name}.bias"]) for name in names]
        self._convolutions = [(w.detach().float(), b.detach().float()) for w, b in convolutions]
        self._linear = [w.detach().float() for w in linear]

    @classmethod
    def pretrained(cls, trunk_path: Path | str | None = None) -> LPIPS:
        """Load the published weights. Arguments and errors: see `trunk_weights`."""
        return cls(trunk_weights(trunk_path), linear_weights())

    def __call__(self, image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]) -> Float[Tensor, " n"]:
        """Compute the distance of each pair of images in [-1, 1].

        Raises:
            ValueError: If an image has fewer than 16 pixels per side.
        """
        if min(image.shape[-2:]) < MIN_SIZE:
            raise ValueError(
                f"LPIPS needs images of at least {MIN_SIZE} pixels per side, got {tuple(image.shape[-2:])}"
            )
        self._move_to(image.device)
        with torch.autocast(image.device.type, enabled=False):
            features, targets = self._features(image.float()), self._features(reference.float())
            distances = [
                ((_unit(x) - _unit(y)).square() * weight[:, None, None]).sum(dim=1).mean(dim=(1, 2))
                for x, y, weight in zip(features, targets, self._linear, strict=True)
            ]
            return torch.stack(distances).sum(dim=0)

    def _features(self, image: Tensor) -> list[Tensor]:
        """Return the activations after the last ReLU of each stage, [N, 64..512, H / 2^s, W / 2^s]."""
        x = (image - image.new_tensor(_SHIFT)[:, None, None]) / image.new_tensor(_SCALE)[:, None, None]
        features, convolutions = [], iter(self._convolutions)
        for stage, depth in enumerate(STAGES):
            x = F.max_pool2d(x, 2) if stage else x
            for _ in range(depth):
                weight, bias = next(convolutions)
                x = F.relu(F.conv2d(x, weight, bias, padding=1))
            features.append(x)
        return features

    def _move_to(self, device: torch.device) -> None:
        if self._linear[0].device != device:
            self._convolutions = [(w.to(device), b.to(device)) for w, b in self._convolutions]
            self._linear = [w.to(device) for w in self._linear]


def _unit(features: Tensor) -> Tensor:
    """Normalize features over channels. The eps inside the root keeps the gradient of zero features finite."""
    norm = (features.square().sum(dim=1, keepdim=True) + _NORM_EPS**2).sqrt()
    return features / (norm + _NORM_EPS)
