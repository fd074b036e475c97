"""L1 split by bounce and by surface roughness."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from rfpp.metrics.baselines import DirectLight

Images = Float[Tensor, "n 3 h w"]
PerImage = Float[Tensor, " n"]

#: G-buffer channels that separate the parts, besides those of the baselines.
CHANNELS = ("roughness", "depth")
#: Upper roughness of smooth and of glossy surfaces.
SMOOTH, GLOSSY = 0.25, 0.5


def l1_parts(prediction: Images, reference: Images, gbuffer: Mapping[str, Tensor]) -> dict[str, PerImage]:
    """Split L1 of linear radiance by bounce (two parts) and by roughness (three).

    The error of each pixel and color is divided like the reference: d = min(direct / reference, 1) is the share of
    direct light. Pixels without a surface count as rough.

    Args:
        gbuffer: Channels of the baselines and of `CHANNELS`, [N, 3 or 1, H, W] each.

    Returns:
        Values by the names in `METRICS`.
    """
    error = (prediction - reference).abs()
    direct = DirectLight().predict(gbuffer).float()
    share = (direct / reference.clamp_min(1e-9)).clamp(0, 1)
    roughness = torch.where(gbuffer["depth"] > 0, gbuffer["roughness"], 1.0)
    smooth, rough = roughness < SMOOTH, roughness >= GLOSSY
    parts = {
        "l1_direct": share,
        "l1_indirect": 1 - share,
        "l1_smooth": smooth,
        "l1_glossy": ~(smooth | rough),
        "l1_rough": rough,
    }
    return {name: (error * part).flatten(1).mean(dim=1) for name, part in parts.items()}
