"""Trivial baselines for comparison with learned results: linear radiance from G-buffer channels."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping

import torch
from jaxtyping import Float
from scipy.optimize import minimize_scalar
from torch import Tensor

from rfpp.imaging.radiance import log_decode, log_encode

Images = Float[Tensor, "n 3 h w"]

#: G-buffer channels that baselines read, of three numbers each.
CHANNELS = ("albedo", "specular", "direct_diffuse", "direct_glossy", "reflected_light")


class Baseline(ABC):
    """A predictor that reads G-buffer channels."""

    name: str

    def fit(self, samples: Iterable[tuple[Mapping[str, Images], Images]]) -> Baseline:
        """Fit to training views, pairs of channels and linear radiance; return self."""
        return self

    @abstractmethod
    def predict(self, gbuffer: Mapping[str, Images]) -> Images:
        """Predict linear radiance from channels."""


class Black(Baseline):
    """No light at all."""

    name = "black"

    def predict(self, gbuffer: Mapping[str, Images]) -> Images:
        return torch.zeros_like(gbuffer["albedo"])


class DirectLight(Baseline):
    """Direct light without any indirect light. Exact, except for noise."""

    name = "direct light"

    def predict(self, gbuffer: Mapping[str, Images]) -> Images:
        return gbuffer["albedo"] * gbuffer["direct_diffuse"] + gbuffer["specular"] * gbuffer["direct_glossy"]


class DirectLightAndReflections(DirectLight):
    """Direct light and its reflection in glossy surfaces."""

    name = "direct light and reflections"

    def predict(self, gbuffer: Mapping[str, Images]) -> Images:
        return super().predict(gbuffer) + gbuffer["specular"] * gbuffer["reflected_light"]


class MeanImage(Baseline):
    """Mean training image, the same for every view.

    The mean is taken of log10(1 + radiance), like the error. Bright highlights would dominate a linear mean.
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
    """Albedo times one number, as if every surface were equally lit.

    The number minimizes the mean |log10(1 + c a) - log10(1 + y)| over a regular subset of the training pixels.
    """

    name = "albedo x constant"

    #: Pixels read per image.
    PIXELS_PER_IMAGE = 1024
    #: Search range, in powers of ten of the constant.
    SEARCH = (-3.0, 2.0)

    def fit(self, samples: Iterable[tuple[Mapping[str, Images], Images]]) -> AlbedoTimesConstant:
        albedos, targets = [], []
        for gbuffer, image in samples:
            albedo = gbuffer["albedo"]
            pixels = albedo.shape[-2] * albedo.shape[-1]
            stride = pixels // self.PIXELS_PER_IMAGE | 1  # odd, to avoid the same columns in every row
            albedos.append(albedo.float().flatten(2)[..., ::stride].flatten())
            targets.append(log_encode(image.float()).flatten(2)[..., ::stride].flatten())
        albedo, target = torch.cat(albedos), torch.cat(targets)
        visible = albedo > 0  # elsewhere the prediction is zero for any constant
        albedo, target = albedo[visible], target[visible]

        def error(exponent: float) -> float:
            return (log_encode(10**exponent * albedo) - target).abs().mean().item()

        self.constant = 10 ** float(minimize_scalar(error, bounds=self.SEARCH, method="bounded").x)
        return self

    def predict(self, gbuffer: Mapping[str, Images]) -> Images:
        return self.constant * gbuffer["albedo"]
