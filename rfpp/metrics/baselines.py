"""Trivial baselines for comparison with learned results.

All are fitted on training views and predict linear radiance from what the G-buffer holds (`CHANNELS`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.imaging.radiance import log_decode, log_encode

Images = Float[Tensor, "n 3 h w"]

#: The G-buffer channels that predictors are given, all of three numbers.
CHANNELS = ("albedo", "specular", "direct_diffuse", "direct_glossy", "reflected_light")


class Baseline(ABC):
    """A predictor without a network."""

    name: str

    def fit(self, samples: Iterable[tuple[Mapping[str, Images], Images]]) -> Baseline:
        """Learn from (channels, linear radiance) pairs; returns self."""
        return self

    @abstractmethod
    def predict(self, gbuffer: Mapping[str, Images]) -> Images:
        """Linear radiance of views with these channels."""


class Black(Baseline):
    """Predicts no light at all."""

    name = "black"

    def predict(self, gbuffer: Mapping[str, Images]) -> Images:
        return torch.zeros_like(gbuffer["albedo"])


class DirectLightAlone(Baseline):
    """Predicts the first bounce, exact but for the noise of its samples, and nothing of what follows."""

    name = "direct light alone"

    def predict(self, gbuffer: Mapping[str, Images]) -> Images:
        return gbuffer["albedo"] * gbuffer["direct_diffuse"] + gbuffer["specular"] * gbuffer["direct_glossy"]


class DirectLightReflected(DirectLightAlone):
    """Predicts the first bounce and its reflection in shiny surfaces, and nothing of what follows."""

    name = "reflections too"

    def predict(self, gbuffer: Mapping[str, Images]) -> Images:
        return super().predict(gbuffer) + gbuffer["specular"] * gbuffer["reflected_light"]


class MeanImage(Baseline):
    """Predicts, for every view, the mean training image.

    The mean is taken of log10(1 + radiance), where the error is measured too; a linear mean would be drawn up by a
    few bright highlights and be a weaker opponent.
    """

    name = "mean image"

    def fit(self, samples: Iterable[tuple[Mapping[str, Images], Images]]) -> MeanImage:
        total: Tensor | float = 0.0
        count = 0
        for _, image in samples:
            total = total + log_encode(image.double()).sum(dim=0)
            count += len(image)
        self.image = log_decode(torch.as_tensor(total / count)).float()  # [3, h, w]
        return self

    def predict(self, gbuffer: Mapping[str, Images]) -> Images:
        albedo = gbuffer["albedo"]
        return self.image.to(albedo.device).expand_as(albedo).clone()


class AlbedoTimesConstant(Baseline):
    """Predicts albedo times one number: every surface equally lit.

    The number minimises the mean |log10(1 + c a) - log10(1 + y)| over a regular subset of the training pixels.
    """

    name = "albedo x constant"

    #: Pixels read per image; a few thousand images give far more than one number needs.
    PIXELS_PER_IMAGE = 1024
    #: Range searched, in powers of ten of the constant.
    SEARCH = (-3.0, 2.0)

    def fit(self, samples: Iterable[tuple[Mapping[str, Images], Images]]) -> AlbedoTimesConstant:
        albedos, targets = [], []
        for gbuffer, image in samples:
            albedo = gbuffer["albedo"]
            pixels = albedo.shape[-2] * albedo.shape[-1]
            stride = pixels // self.PIXELS_PER_IMAGE | 1  # odd, so as not to read the same columns in every row
            albedos.append(albedo.float().flatten(2)[..., ::stride].flatten())
            targets.append(log_encode(image.float()).flatten(2)[..., ::stride].flatten())
        albedo, target = torch.cat(albedos), torch.cat(targets)
        visible = albedo > 0  # elsewhere the prediction is zero whatever the constant
        self.constant = _minimiser(albedo[visible], target[visible], *self.SEARCH)
        return self

    def predict(self, gbuffer: Mapping[str, Images]) -> Images:
        return self.constant * gbuffer["albedo"]


def _minimiser(albedo: Tensor, target_log: Tensor, low: float, high: float) -> float:
    """The c in 10^[low, high] of least log-L1: a grid in the exponent, thrice refined about its best point."""
    for _ in range(4):
        exponents = torch.linspace(low, high, 21).tolist()
        losses = [(log_encode(10**e * albedo) - target_log).abs().mean().item() for e in exponents]
        best = min(range(len(losses)), key=losses.__getitem__)
        low, high = exponents[max(best - 1, 0)], exponents[min(best + 1, len(exponents) - 1)]
    return float(10 ** exponents[best])
