"""Mixed precision inside a network."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext

import torch
from torch import Tensor


def as_multiplied(x: Tensor) -> Tensor:
    """In the dtype that autocast, if it is on, converts to for matrix products. "meta" knows no autocast."""
    device = x.device.type
    return x.to(torch.get_autocast_dtype(device)) if not x.is_meta and torch.is_autocast_enabled(device) else x


def in_float32(x: Tensor) -> AbstractContextManager:
    """Context in which matrix products are computed in float32. "meta" knows no autocast."""
    return nullcontext() if x.is_meta else torch.autocast(x.device.type, enabled=False)
