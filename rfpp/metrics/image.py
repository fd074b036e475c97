"""Image metrics, one value per image, on linear HDR radiance.

`METRICS` states the formula of each metric, its direction, its tone map and its epsilon. Metrics have no state; callers
average the values over views, scenes and devices.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import torch
from jaxtyping import Float
from torch import Tensor
from torchmetrics.functional.image import peak_signal_noise_ratio, structural_similarity_index_measure

from rfpp.imaging.radiance import log_encode, perceptual
from rfpp.metrics.l1_parts import GLOSSY, SMOOTH, l1_parts
from rfpp.metrics.lpips import LPIPS, TRUNK_SHA256

#: Bounds the relative error of nearly black pixels.
MAPE_EPS = 0.01

#: Formula of `perceptual` in tables.
TONE_MAP = "clamp(log2(1 + I), 0, 1)"

Images = Float[Tensor, "n 3 h w"]
PerImage = Float[Tensor, " n"]
Function = Callable[[Images, Images], PerImage]


@dataclass(frozen=True)
class Metric:
    """Description of a metric."""

    label: str
    higher_is_better: bool
    definition: str
    decimals: int

    @property
    def heading(self) -> str:
        """Column heading: the label and an arrow towards better values."""
        return f"{self.label} {'↑' if self.higher_is_better else '↓'}"


METRICS = MappingProxyType(
    {
        "log_l1": Metric("log-L1", False, "mean |log10(1 + x) - log10(1 + y)|", 4),
        "l1": Metric("L1", False, "mean |x - y|, linear HDR", 4),
        "mape": Metric("MAPE", False, f"mean |x - y| / (|y| + {MAPE_EPS}), linear HDR", 4),
        "lpips": Metric("LPIPS", False, f"v0.1, VGG16 {TRUNK_SHA256[:8]}, on {TONE_MAP} scaled to [-1, 1]", 4),
        "ssim": Metric("SSIM", True, f"11x11 Gaussian, sigma 1.5, range 1, mirrored border, on {TONE_MAP}", 4),
        "psnr": Metric("PSNR", True, f"dB, peak 1, on {TONE_MAP}", 2),
        "gradient": Metric("grad.", False, f"mean |∂I(x) - ∂I(y)| along rows and columns of {TONE_MAP}", 4),
        "l1_direct": Metric("direct", False, "L1 of direct light: mean |x - y| d, d: its share in y, linear HDR", 4),
        "l1_indirect": Metric("indir.", False, "L1 of indirect light: mean |x - y| (1 - d), linear HDR", 4),
        "l1_smooth": Metric("smooth", False, f"part of L1 from surfaces with roughness below {SMOOTH}", 4),
        "l1_glossy": Metric("glossy", False, f"part of L1 from surfaces with roughness from {SMOOTH} to {GLOSSY}", 4),
        "l1_rough": Metric("rough", False, f"part of L1 from surfaces with roughness of {GLOSSY} and more", 4),
    }
)


def log_l1(prediction: Images, reference: Images) -> PerImage:
    """Compute mean `|log10(1 + x) - log10(1 + y)|`."""
    return (log_encode(prediction) - log_encode(reference)).abs().flatten(1).mean(dim=1)


def l1(prediction: Images, reference: Images) -> PerImage:
    """Compute mean `|x - y|` of linear radiance."""
    return (prediction - reference).abs().flatten(1).mean(dim=1)


def mape(prediction: Images, reference: Images) -> PerImage:
    """Compute mean `|x - y| / (|y| + 0.01)` of linear radiance, as a fraction."""
    return ((prediction - reference).abs() / (reference.abs() + MAPE_EPS)).flatten(1).mean(dim=1)


def psnr(prediction: Images, reference: Images) -> PerImage:
    """Compute the peak signal-to-noise ratio of tone-mapped images in dB; infinite for equal images."""
    return peak_signal_noise_ratio(
        perceptual(prediction), perceptual(reference), data_range=1.0, reduction="none", dim=(1, 2, 3)
    )


def ssim(prediction: Images, reference: Images) -> PerImage:
    """Compute the structural similarity (Wang et al. 2004) of tone-mapped images.

    The mean covers every pixel; the image is mirrored at its border. skimage omits the border, so its numbers differ
    slightly.
    """
    similarity = structural_similarity_index_measure(
        perceptual(prediction), perceptual(reference), data_range=1.0, reduction="none"
    )
    assert isinstance(similarity, Tensor)  # a tuple only with return_full_image
    return similarity.reshape(len(prediction))


def gradient(prediction: Images, reference: Images) -> PerImage:
    """Compute the error of edges and textures: mean `|∂I(x) - ∂I(y)|` of tone-mapped images.

    ∂ is the difference of neighboring pixels. Means along rows and along columns are averaged.
    """
    difference = perceptual(prediction) - perceptual(reference)
    rows, columns = (difference.diff(dim=dim).abs().flatten(1).mean(dim=1) for dim in (-2, -1))
    return (rows + columns) / 2


class ImageMetrics:
    """All metrics of METRICS for a batch of images.

    Args:
        lpips: LPIPS metric; None omits it.
        detailed: Whether to add `gradient` and `l1_parts`.
    """

    def __init__(self, lpips: LPIPS | None, detailed: bool = False) -> None:
        self.detailed = detailed
        self._functions: dict[str, Function] = {"log_l1": log_l1, "l1": l1, "mape": mape, "ssim": ssim, "psnr": psnr}
        if lpips is not None:
            self._functions["lpips"] = lambda x, y: lpips(2 * perceptual(x) - 1, 2 * perceptual(y) - 1)
        if detailed:
            self._functions["gradient"] = gradient
        self.names = tuple(name for name in METRICS if name in self._functions)

    @torch.no_grad()
    def __call__(
        self, prediction: Images, reference: Images, gbuffer: Mapping[str, Tensor] | None = None
    ) -> dict[str, PerImage]:
        """Compute all metrics of linear radiance by name, in float32; detailed ones need a G-buffer (`l1_parts`)."""
        with torch.autocast(prediction.device.type, enabled=False):
            x, y = prediction.float(), reference.float()
            values = {name: self._functions[name](x, y) for name in self.names}
            if not self.detailed:
                return values
            if gbuffer is None:
                raise ValueError("detailed metrics need a G-buffer, see l1_parts")
            return values | l1_parts(x, y, gbuffer)
