"""Muon for hidden matrices and AdamW for everything else, as one optimizer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.optim import AdamW, Muon, Optimizer

from rfpp.training.module import HIDDEN


class MuonWithAdamW(Optimizer):
    """Hidden layers step along the orthogonalised momentum of their gradients (Jordan et al. 2024, "Muon").

    What the layers read from and write to, and everything that is no matrix, is left to AdamW, as the method's authors
    advise. Muon's step is scaled to the root mean square of AdamW's (Liu et al. 2025, "Muon is scalable for LLM
    training"), so that one learning rate and one decay serve both. Layers that are stacked in one parameter (queries,
    keys and values; gate and value) are orthogonalised as the one matrix that they are stored as.

    Args:
        groups: of parameters, see `rfpp.training.module.decay_groups`.
        lr, weight_decay: of both.
        momentum: of Muon.
        betas: of AdamW.
        fused: AdamW in one kernel.
    """

    def __init__(
        self,
        groups: Iterable[dict[str, Any]],
        lr: float,
        weight_decay: float,
        momentum: float,
        betas: Sequence[float],
        fused: bool,
    ):
        hidden, others = _divided(groups)
        muon = Muon(hidden, lr=lr, weight_decay=weight_decay, momentum=momentum, adjust_lr_fn="match_rms_adamw")
        adam = AdamW(others, lr=lr, weight_decay=weight_decay, betas=tuple(betas), fused=fused)
        super().__init__([*muon.param_groups, *adam.param_groups], {})
        self._parts = muon, adam
        self._share()

    def _share(self) -> None:
        """Share one state and one list of groups between both optimizers."""
        for part in self._parts:
            mine = [group for group in self.param_groups if ("betas" in group) == isinstance(part, AdamW)]
            part.param_groups, part.state = mine, self.state

    @torch.no_grad()
    def step(self, closure: Callable[[], Tensor] | None = None) -> Tensor | None:
        """Of both. `closure`, where given, computes loss and gradients first."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for part in self._parts:
            part.step()
        return loss

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        super().load_state_dict(state_dict)
        self._share()


def _divided(groups: Iterable[Mapping[str, Any]]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Split parameter groups into hidden matrices and all other parameters, keeping their settings."""
    divided: tuple[list[dict[str, Any]], list[dict[str, Any]]] = ([], [])
    for group in groups:
        settings = {name: value for name, value in group.items() if name not in ("params", HIDDEN)}
        flags = group.get(HIDDEN, [False] * len(group["params"]))
        for into, wanted in zip(divided, (True, False), strict=True):
            chosen = [p for p, hidden in zip(group["params"], flags, strict=True) if hidden == wanted]
            if chosen:
                into.append({**settings, "params": chosen})
    return divided
