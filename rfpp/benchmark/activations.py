"""What a training step keeps for its backward pass, part by part, counted without running one."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any

from torch import Tensor, nn
from torch.autograd.graph import saved_tensors_hooks
from torch.multiprocessing.reductions import StorageWeakRef

from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.process import GB
from rfpp.benchmark.cost.rows import Row
from rfpp.benchmark.cost.tasks import Setting, Untrained
from rfpp.losses.rendering import RenderingLoss

#: What is in no part or layer.
REST = "rest"


def measure(
    networks: Mapping[str, Untrained],
    case: Case,
    parts: Sequence[str],
    layers: Sequence[str],
    loss: RenderingLoss,
    setting: Setting,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """A row per network, part and layer, the largest first, and one for each network's sum.

    `kept_GB` are of all tensors that autograd saves in the forward pass and the loss, each storage once, without
    parameters; they are freed at once, so that a case may be larger than memory. Nothing is timed: the same
    code gives the same numbers on any machine of the same kind. `peak_GB` of `benchmark=cost` has gradients, moments
    and what the backward pass takes on its way besides.

    Args:
        networks: by any key.
        case: that is trained on.
        parts: names of modules that are told apart, as `decoder.blocks`; of two that match the longer counts.
        layers: names of classes that are told apart within a part; the innermost counts.
        loss: of the step.
        setting: where and in which precision.
        progress: called with (networks measured, networks in all).
    """
    setting.apply()
    for done, untrained in enumerate(networks.values()):
        progress(done, len(networks))
        network = setting.network(untrained).train()
        batch = case.batch(network.gbuffer_channels, setting.seed).to(setting.where)
        step = partial(_forward, network, batch, loss.to(setting.where), setting)
        kept = kept_for_backward(network, step, parts, layers)
        shared = {"network": untrained.name, **vars(case), "precision": setting.precision, "device": setting.where}
        for (part, layer), size in sorted(kept.items(), key=lambda item: -item[1]):
            yield {**shared, "part": part, "layer": layer, "kept_GB": size / GB}
        yield {**shared, "part": "all", "layer": "all", "kept_GB": sum(kept.values()) / GB}
    progress(len(networks), len(networks))


def _forward(network: nn.Module, batch: Any, loss: RenderingLoss, setting: Setting) -> None:
    with setting.autocast():
        made = network(batch)
        loss(made.log_radiance, made.transport_states, batch.image, made.state_segments)


def kept_for_backward(
    network: nn.Module, forward: Callable[[], Any], parts: Sequence[str], layers: Sequence[str]
) -> dict[tuple[str, str], int]:
    """(part, layer) → bytes that `forward` would keep; see `measure`."""
    own = {StorageWeakRef(p.untyped_storage()).cdata for p in network.parameters()}
    # a weak reference keeps its number from being given to another storage
    counted: dict[int, StorageWeakRef] = {}
    sizes: dict[tuple[str, str], int] = defaultdict(int)
    inside: list[tuple[str, str]] = [(REST, REST)]

    def count(tensor: Tensor) -> None:
        storage = tensor.untyped_storage()
        reference = StorageWeakRef(storage)
        if reference.cdata not in own and reference.cdata not in counted:
            counted[reference.cdata] = reference
            sizes[inside[-1]] += storage.nbytes()

    def never(_: None) -> Tensor:
        raise RuntimeError("what was kept was counted and freed: there is no backward pass")

    with ExitStack() as hooks:
        for name, module in network.named_modules():
            part = max((p for p in parts if name == p or name.startswith(f"{p}.")), key=len, default=None)
            layer = type(module).__name__ if type(module).__name__ in layers else None
            if part is None and layer is None:
                continue

            def enter(*_: Any, part: str | None = part, layer: str | None = layer) -> None:
                inside.append((part or inside[-1][0], layer or inside[-1][1]))

            def leave(*_: Any) -> None:
                inside.pop()

            hooks.callback(module.register_forward_pre_hook(enter).remove)
            hooks.callback(module.register_forward_hook(leave).remove)
        with saved_tensors_hooks(count, never):
            forward()
    return dict(sizes)
