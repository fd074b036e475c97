"""Build a model from an untrusted configuration: only classes of `rfpp.model` and `rfpp.radiosity`, of bounded size."""

from __future__ import annotations

import importlib
from typing import Any

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from rfpp.errors import CheckpointError
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.radiosity.radiosity import Radiosity

#: Packages whose classes a checkpoint may name; anything else is refused, not imported.
ALLOWED_PREFIXES = ("rfpp.model.", "rfpp.radiosity.")
#: Largest number in a network's configuration, and largest number of repetitions.
_LARGEST, _MOST_TIMES = 1 << 20, 1024
_TIMES = ("layers", "iterations", "frequencies", "bounces")


def build_network(config: Any, weights: dict[str, Tensor], where: str) -> RenderFormerPP | Radiosity:
    """Build the network of a configuration, without loading its weights, which are checked first.

    Raises:
        CheckpointError: If the configuration describes no network, or one that the weights do not fit.
    """
    shape = shapes_of(config, where)
    if not isinstance(shape, RenderFormerPP | Radiosity):
        raise CheckpointError(f"{where}: its configuration describes no network: use the version of rfpp that wrote it")
    require_fitting(shape, weights, where)
    return build(config, where)


def shapes_of(config: Any, where: str) -> Any:
    """Build a configuration without memory for its weights. Raises CheckpointError if no checkpoint may hold it."""
    with torch.device("meta"), _ShapesOnly():
        return build(config, where)


def build(config: Any, where: str) -> Any:
    """Instantiate a nested `_target_` config whose targets all lie in `ALLOWED_PREFIXES`. Raises CheckpointError."""
    if isinstance(config, list | tuple):
        return [build(item, where) for item in config]
    if not isinstance(config, dict):
        return _usual(config, where)
    arguments = {key: build(value, where) for key, value in config.items() if key != "_target_"}
    if "_target_" not in config:
        return arguments
    for name, value in arguments.items():
        if str(name).endswith(_TIMES) and isinstance(value, int) and value > _MOST_TIMES:
            raise CheckpointError(f"{where}: {name}={value} is more than {_MOST_TIMES}: refused")
    target = config["_target_"]
    if not isinstance(target, str) or not target.startswith(ALLOWED_PREFIXES):
        raise CheckpointError(
            f"{where}: names {target!r}, which is not in {' or '.join(p[:-1] for p in ALLOWED_PREFIXES)}: refused; add "
            "classes of your own to rfpp/model"
        )
    module_name, _, class_name = target.rpartition(".")
    try:
        part = getattr(importlib.import_module(module_name), class_name)
        if not (isinstance(part, type) and part.__module__ == module_name):
            raise AttributeError(f"{target} is not a class defined there")
        return part(**arguments)
    except Exception as error:  # untrusted arguments fail in many ways
        reason = (str(error).strip() or type(error).__name__).splitlines()[0][:160]
        raise CheckpointError(
            f"{where}: cannot build {target} ({reason}): use the version of rfpp that wrote it"
        ) from None


class _ShapesOnly(TorchFunctionMode):
    """Skip operations that need values: without memory there are none, and they import PyTorch's compiler."""

    _OF_ONE_SHAPE = (torch.Tensor.normal_, torch.Tensor.__rpow__)

    def __torch_function__(self, func, types, args=(), kwargs=None):
        return args[0] if func in self._OF_ONE_SHAPE else func(*args, **(kwargs or {}))


def require_fitting(network: nn.Module, weights: dict[str, Tensor], where: str) -> None:
    """Raise CheckpointError unless names and shapes of all weights are those of the network."""
    expected = network.state_dict()
    missing, extra = sorted(expected.keys() - weights.keys()), sorted(weights.keys() - expected.keys())
    wrong = sorted(k for k in expected.keys() & weights.keys() if expected[k].shape != weights[k].shape)
    for problem, names in (("lacks", missing), ("has the unknown tensor", extra), ("has another shape for", wrong)):
        if names:
            raise CheckpointError(
                f"{where}: {problem} {names[0]} (and {len(names) - 1} more): it belongs to another model"
            )


def _usual(value: Any, where: str) -> Any:
    if isinstance(value, int | float) and not -_LARGEST <= value <= _LARGEST:  # NaN is neither
        raise CheckpointError(f"{where}: its configuration holds a number beyond ±{_LARGEST:,}: refused")
    return value
