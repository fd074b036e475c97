"""LPIPS (Zhang et al., CVPR 2018) with the VGG16 trunk, in plain torch.

Equal to the `lpips` package, version 0.1 of its linear weights, without needing torchvision. It is a frozen function
and not an `nn.Module`: its weights are nobody's parameters or buffers, so they reach no checkpoint, optimizer or
distributed wrapper, there is no train mode to switch on, and no module-wide cast can lower their precision.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from rfpp.metrics.lpips_weights import CONV_CHANNELS, linear_weights, trunk_weights

#: Convolutions of each VGG16 stage; stages are separated by 2x2 max pooling, and LPIPS reads the end of each.
STAGES = (2, 2, 3, 3, 3)
#: Four poolings and a last convolution need this many pixels a side.
MIN_SIZE = 16

_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
_NORM_EPS = 1e-10


class LPIPS:
    """Learned perceptual distance between images; differentiable in both, always computed in float32.

    Args:
        trunk: torchvision's VGG16 convolutions by their names (`trunk_weights()`).
        linear: the five [C] channel weights (`linear_weights()`).

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
        """The published metric; `trunk_path` and the errors raised are those of `trunk_weights`."""
        return cls(trunk_weights(trunk_path), linear_weights())

    def __call__(self, image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]) -> Float[Tensor, " n"]:
        """Distance of each pair; images in [-1, 1], at least 16 pixels a side.

        Raises:
            ValueError: images too small for the trunk.
        """
        if min(image.shape[-2:]) < MIN_SIZE:
            raise ValueError(f"LPIPS needs images of at least {MIN_SIZE} pixels a side, got {tuple(image.shape[-2:])}")
        self._move_to(image.device)
        with torch.autocast(image.device.type, enabled=False):
            features, targets = self._features(image.float()), self._features(reference.float())
            distances = [
                ((_unit(x) - _unit(y)).square() * weight[:, None, None]).sum(dim=1).mean(dim=(1, 2))
                for x, y, weight in zip(features, targets, self._linear, strict=True)
            ]
            return torch.stack(distances).sum(dim=0)

    def _features(self, image: Tensor) -> list[Tensor]:
        """Activations after the last ReLU of each stage: [N, 64..512, H / 2^s, W / 2^s]."""
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
    """Features of unit length over channels. The eps inside the root keeps the gradient finite where all are zero."""
    norm = (features.square().sum(dim=1, keepdim=True) + _NORM_EPS**2).sqrt()
    return features / (norm + _NORM_EPS)
