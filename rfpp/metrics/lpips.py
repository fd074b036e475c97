"""LPIPS (Zhang et al., CVPR 2018) with the VGG16 trunk, from the package `lpips`."""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Mapping
from pathlib import Path

import torch
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor
from torch.nn.functional import normalize

from rfpp.errors import MissingDependencyError

_LAYERS = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
#: Parameters of VGG16's convolutions, in order, by torchvision's names.
TRUNK = tuple(f"features.{layer}.{kind}" for layer in _LAYERS for kind in ("weight", "bias"))
#: Hash of torchvision's ImageNet weights, vgg16-397923af.pth, see `trunk_sha256`.
TRUNK_SHA256 = "40acdda7c6b05249f81637b2571671ce938507c5f986db17af374cf62a2f42a6"


class LPIPS:
    """Learned perceptual distance between images, differentiable in both and computed in float32.

    Not an `nn.Module`: weights stay out of checkpoints and optimizers, and keep their mode and precision.

    Args:
        trunk: Parameters of `TRUNK`, float32; the published ones by `load_trunk`.
    """

    def __init__(self, trunk: Mapping[str, Tensor]) -> None:
        import lpips  # optional

        with torch.device("meta"), warnings.catch_warnings(action="ignore"):  # meta: no random initialization
            network = lpips.LPIPS(net="vgg", pretrained=False, pnet_rand=True, verbose=False)
        linear = Path(lpips.__file__).parent / "weights/v0.1/vgg.pth"
        weights = torch.load(linear, map_location="cpu", weights_only=True)
        weights |= {f"net.{name}": trunk[f"features.{name.partition('.')[2]}"] for name in network.net.state_dict()}
        network.load_state_dict(weights, strict=False, assign=True)  # the package lists linear weights twice
        self._network = network.eval().requires_grad_(False)

    def __call__(self, image: Float[Tensor, "n 3 h w"], reference: Float[Tensor, "n 3 h w"]) -> Float[Tensor, " n"]:
        """Compute the distance of each pair of images in [-1, 1]."""
        network = self._network.to(image.device)
        with torch.autocast(image.device.type, enabled=False):
            features, targets = (network.net(network.scaling_layer(x.float())) for x in (image, reference))
            # The package's own normalization has NaN gradients where all features of a pixel vanish.
            distances = [
                linear((normalize(x, eps=1e-10) - normalize(y, eps=1e-10)).square()).mean(dim=(1, 2, 3))
                for linear, x, y in zip(network.lins, features, targets, strict=True)
            ]
            return torch.stack(distances).sum(dim=0)


def load_trunk() -> dict[str, Tensor]:
    """Load the trunk from the user cache. Raises MissingDependencyError if it is missing or damaged."""
    try:
        if trunk_sha256(trunk := load_file(trunk_file())) == TRUNK_SHA256:
            return trunk
    except (OSError, SafetensorError, KeyError):
        pass
    raise MissingDependencyError(
        f"{trunk_file()}: the VGG16 weights of LPIPS are missing or damaged: run `rfpp weights`, or omit LPIPS: "
        "loss.lpips_weight=0 in training, evaluation.lpips=false in evaluation"
    )


def trunk_file() -> Path:
    """Return the path of the trunk in the user cache ($XDG_CACHE_HOME, else ~/.cache)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rfpp" / "vgg16-trunk.safetensors"


def trunk_sha256(trunk: Mapping[str, Tensor]) -> str:
    """Return the sha256 of the float32 values in the order of `TRUNK`. Raises KeyError if one is missing."""
    return hashlib.sha256(b"".join(trunk[name].float().numpy().tobytes() for name in TRUNK)).hexdigest()
