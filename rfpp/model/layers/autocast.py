"""Mixed precision inside a network."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

import torch
from torch import Tensor


def as_multiplied(x: Tensor) -> Tensor:
    """Convert to the dtype that autocast uses for matrix products, if it is on; "meta" has no autocast."""
    device = x.device.type
    return x.to(torch.get_autocast_dtype(device)) if not x.is_meta and torch.is_autocast_enabled(device) else x


def in_float32(x: Tensor) -> AbstractContextManager:
    """Return a context in which matrix products are computed in float32; "meta" has no autocast."""
    return nullcontext() if x.is_meta else torch.autocast(x.device.type, enabled=False)
