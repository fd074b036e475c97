"""Learning-rate schedules, stepped once per optimizer step."""

from __future__ import annotations

import math

from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR

from rfpp.ranges import NonNegative, Positive, Share


def warmup_cosine(
    optimizer: Optimizer, warmup_steps: NonNegative, total_steps: Positive, final_fraction: Share
) -> LambdaLR:
    """Return a schedule with linear warm-up and cosine decay."""

    def factor(step: int) -> float:
        if step < warmup_steps:
            return (step + 1) / warmup_steps
        progress = min(1.0, (step - warmup_steps) / max(1, total_steps - warmup_steps))
        return final_fraction + (1 - final_fraction) * 0.5 * (1 + math.cos(math.pi * progress))

    return LambdaLR(optimizer, factor)
