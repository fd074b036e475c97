"""Devices on which renderers run."""

from __future__ import annotations

import torch

from rfpp.errors import UserError


def available_device(name: torch.device | str | None) -> torch.device:
    """Return a device; without a name a GPU if there is one, else the CPU. Raises UserError if it is not available."""
    try:
        device = torch.device(name or ("cuda" if torch.cuda.is_available() else "cpu"))
        torch.zeros(1, device=device).item()  # some devices hold no values
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).splitlines()[0]
        raise UserError(f"device={name}: is not available ({reason}): give cpu, or null to choose") from None
    return device
