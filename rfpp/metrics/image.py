"""Image metrics, one value per image, on linear HDR radiance.

What each metric is, which way it improves, and which tone map and epsilon it uses is stated once, in METRICS.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import torch
from jaxtyping import Float
from torch import Tensor
from torchmetrics.functional.image import structural_similarity_index_measure

from rfpp.imaging.radiance import log_encode, perceptual
from rfpp.metrics.l1_parts import GLOSSY, SMOOTH, l1_parts
from rfpp.metrics.lpips import LPIPS

#: Keeps the relative error of nearly black pixels bounded.
MAPE_EPS = 0.01

#: How `perceptual` is written beneath a table.
TONE_MAP = "clamp(log2(1 + I), 0, 1)"

Images = Float[Tensor, "n 3 h w"]
PerImage = Float[Tensor, " n"]
Function = Callable[[Images, Images], PerImage]


@dataclass(frozen=True)
class Metric:
    """How a metric is shown and read.

    Attributes:
        label: column heading.
        higher_is_better: direction.
        definition: formula with its tone map and epsilon.
        decimals: digits in a table.
    """

    label: str
    higher_is_better: bool
    definition: str
    decimals: int

    @property
    def heading(self) -> str:
        """Of a column: the label and an arrow towards better values."""
        return f"{self.label} {'↑' if self.higher_is_better else '↓'}"


METRICS = MappingProxyType(
    {
        "log_l1": Metric("log-L1", False, "mean |log10(1 + x) - log10(1 + y)|", 4),
        "l1": Metric("L1", False, "mean |x - y|, linear HDR", 4),
        "mape": Metric("MAPE", False, f"mean |x - y| / (|y| + {MAPE_EPS}), linear HDR", 4),
        "lpips": Metric("LPIPS", False, f"VGG16 v0.1 on {TONE_MAP} scaled to [-1, 1]", 4),
        "ssim": Metric("SSIM", True, f"11x11 Gaussian, sigma 1.5, range 1, mirrored border, on {TONE_MAP}", 4),
        "psnr": Metric("PSNR", True, f"dB, peak 1, on {TONE_MAP}", 2),
        "gradient": Metric("grad.", False, f"mean |∂I(x) - ∂I(y)| along rows and columns of {TONE_MAP}", 4),
        "l1_direct": Metric("direct", False, "L1 of direct light: mean |x - y| d, d: its share in y, linear HDR", 4),
        "l1_indirect": Metric("indir.", False, "L1 of indirect light: mean |x - y| (1 - d), linear HDR", 4),
        "l1_smooth": Metric("smooth", False, f"share in L1 of surfaces of a roughness below {SMOOTH}", 4),
        "l1_glossy": Metric("glossy", False, f"share in L1 of surfaces of a roughness from {SMOOTH} to {GLOSSY}", 4),
        "l1_rough": Metric("rough", False, f"share in L1 of surfaces of a roughness of {GLOSSY} and more", 4),
    }
)


def log_l1(prediction: Images, reference: Images) -> PerImage:
    """mean |log10(1 + x) - log10(1 + y)|."""
    return (log_encode(prediction) - log_encode(reference)).abs().flatten(1).mean(dim=1)


def l1(prediction: Images, reference: Images) -> PerImage:
    """mean |x - y| of linear radiance."""
    return (prediction - reference).abs().flatten(1).mean(dim=1)


def mape(prediction: Images, reference: Images) -> PerImage:
    """mean |x - y| / (|y| + 0.01) of linear radiance, a fraction (not a percentage)."""
    return ((prediction - reference).abs() / (reference.abs() + MAPE_EPS)).flatten(1).mean(dim=1)


def psnr(prediction: Images, reference: Images) -> PerImage:
    """Peak signal-to-noise ratio in dB of tone-mapped images; infinite for equal ones."""
    error = (perceptual(prediction) - perceptual(reference)).square().flatten(1).mean(dim=1)
    return -10 * torch.log10(error)


def ssim(prediction: Images, reference: Images) -> PerImage:
    """Structural similarity (Wang et al. 2004) of tone-mapped images.

    The mean covers every pixel: windows at the border see the image mirrored. skimage leaves the border out, so its
    numbers differ slightly.
    """
    similarity = structural_similarity_index_measure(
        perceptual(prediction), perceptual(reference), data_range=1.0, reduction="none"
    )
    assert isinstance(similarity, Tensor)  # a pair where the full image is asked for
    return similarity.reshape(len(prediction))


def gradient(prediction: Images, reference: Images) -> PerImage:
    """How far edges and textures are from the reference's: mean |∂I(x) - ∂I(y)| of tone-mapped images.

    ∂ is the difference of neighbours, along rows and along columns; the two means are averaged.
    """
    difference = perceptual(prediction) - perceptual(reference)
    rows, columns = (difference.diff(dim=dim).abs().flatten(1).mean(dim=1) for dim in (-2, -1))
    return (rows + columns) / 2


class ImageMetrics:
    """All metrics of METRICS for a batch of images.

    Args:
        lpips: the LPIPS to use, or None to leave the column out.
        detailed: also `gradient` and `l1_parts`.
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
        """Values by metric name, in float32 whatever the inputs or the surrounding autocast.

        `gbuffer` is needed for detailed ones, see `l1_parts`.
        """
        with torch.autocast(prediction.device.type, enabled=False):
            x, y = prediction.float(), reference.float()
            values = {name: self._functions[name](x, y) for name in self.names}
            if not self.detailed:
                return values
            if gbuffer is None:
                raise ValueError("detailed metrics read a G-buffer, see l1_parts")
            return values | l1_parts(x, y, gbuffer)
