"""Speed and memory of the networks on a GPU; each row is written as soon as it is measured."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

import torch

from rfpp.batch import RaggedBatch
from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.process import GB
from rfpp.benchmark.cost.rows import Row, read_rows
from rfpp.benchmark.cost.tasks import Setting, Task, Untrained
from rfpp.benchmark.loader_and_step import LoaderAndStep
from rfpp.benchmark.repeated import Repeats, Runs, repeated
from rfpp.errors import UserError
from rfpp.model.renderformer_pp import RenderFormerPP
from rfpp.training.flops import matrix_product_rate, published_peak
from rfpp.training.tracking.description import hardware

#: What a table must have to be gone on with.
NEEDED = {"task", "network", "size", "compiled", "triangles", "quantity", "status", "seconds", "hardware", "torch"}


@dataclass(frozen=True)
class Measurement:
    """One thing to measure.

    Attributes:
        task: its name in `measure`'s `tasks`.
        network: its name in `measure`'s `networks`.
        size: of the network, by its name in conf/size.
        compiled: the transformer blocks.
        triangles, objects, views, resolution, scenes: see Case.
    """

    task: str
    network: str
    size: str
    compiled: bool
    triangles: int
    objects: int
    views: int
    resolution: int
    scenes: int

    @property
    def case(self) -> Case:
        return Case(self.triangles, self.objects, self.views, self.resolution, self.scenes)


def measurements(groups: Sequence[Mapping[str, Any]], case: Mapping[str, Any]) -> list[Measurement]:
    """Every combination of each group's values, group by group; what a group does not name is as in `case`."""
    known = {field.name for field in fields(Measurement)}
    made = []
    for group in groups:
        if unknown := group.keys() - known:
            raise UserError(f"benchmark.groups names {', '.join(unknown)}: choose from {', '.join(sorted(known))}")
        lists = [value if isinstance(value, list) else [value] for value in group.values()]
        made += [Measurement(**{**case, **dict(zip(group, values, strict=True))}) for values in product(*lists)]
    return list(dict.fromkeys(made))


def measure(
    compose: Callable[[list[str]], Mapping[str, Any]],
    networks: Mapping[str, Mapping[str, Any]],
    tasks: Mapping[str, Task],
    case: Mapping[str, Any],
    groups: Sequence[Mapping[str, Any]],
    setting: Setting,
    repeats: Repeats,
    loading: LoaderAndStep | None,
    minutes: float | int,
    finished: str | None,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """A row per measurement and quantity of its task, as soon as it is measured.

    `seconds` is the median; `of_peak` (MFU) is the rate of the operations that the network needs, as a share of what
    the card's maker says it does in products of matrices in this precision; `of_matrix_rate` of what it did in them,
    just now. `peak_GB` is what weights, gradients, moments, batch and activations take at most, as CUDA's allocator
    counts. What does not fit has a row whose status says so. The last row is `loading`'s, with columns of its own.

    Args:
        compose: overrides → training's configuration, of which `model` is taken.
        networks: name → `overrides` that choose it.
        tasks: by name.
        case: values that groups do not name.
        groups: what is measured, in order; see `measurements`.
        setting: where and in which precision; `compile` is each measurement's own.
        repeats: how often.
        loading: the loader beside a training step; None leaves it out.
        minutes: after so many nothing further is begun; the same command then goes on.
        finished: rows of an earlier part, if the file exists: they come first and are not measured again.
        progress: called with (measurements done, in all).

    Raises:
        UserError: a group names what is not there, or `finished` is no such table.
    """
    begin = time.monotonic()
    wanted = measurements(groups, case)
    for name, there in (("task", tasks), ("network", networks)):
        if absent := {getattr(m, name) for m in wanted} - there.keys():
            raise UserError(f"benchmark.groups names {name} {', '.join(absent)}: there are {', '.join(there)}")
    known = read_rows(Path(finished), NEEDED, "gpu") if finished and Path(finished).exists() else []
    yield from known
    setting.apply()
    device = torch.device(setting.where)
    here = {"hardware": hardware(device), "torch": torch.__version__, "precision": setting.precision}
    missing = [m for m in wanted if not _measured(asdict(m) | here, known)]
    loads = loading is not None and not _measured(loading.identity | here, known)
    total = len(wanted) + (loading is not None)
    done = total - len(missing) - loads
    if missing:
        rate, peak = matrix_product_rate(device, setting.dtype), published_peak(device, setting.dtype)
    for m in missing:
        progress(done, total)
        if time.monotonic() - begin > 60 * minutes:
            return
        model = compose([*networks[m.network]["overrides"], f"size={m.size}"])["model"]
        result = _measure(Untrained(str(networks[m.network]["name"]), model), tasks[m.task], m, setting, repeats)
        for quantity in tasks[m.task].quantities:
            yield _row(m, quantity, result, rate, peak) | here | {"device": setting.where}
        done += 1
    progress(done, total)
    if loads and time.monotonic() - begin <= 60 * minutes:
        yield loading.row(compose, networks, setting, repeats) | here | {"device": setting.where}
        progress(total, total)


@dataclass(frozen=True)
class _Result:
    """What was measured, operations of each quantity, tokens."""

    runs: Runs
    flops: dict[str, float]
    tokens: int


def _measure(made: Untrained, task: Task, m: Measurement, setting: Setting, repeats: Repeats) -> _Result:
    on_paper = made("meta")
    shapes = m.case.batch(on_paper.gbuffer_channels, setting.seed).to("meta")
    runs = repeated(made, task, m.case, replace(setting, compile=m.compiled), repeats)
    return _Result(runs, task.flops(on_paper, shapes), _tokens(on_paper, shapes))


@torch.no_grad()
def _tokens(network: RenderFormerPP, batch: RaggedBatch) -> int:
    """Scene tokens and ray bundles of a batch."""
    height, width = (side // network.patch_size for side in batch.resolution)
    return network.tokenize(batch)[1].segments.total + len(batch.scenes) * batch.num_views * height * width


def _row(m: Measurement, quantity: str, result: _Result, rate: float, peak: float | None) -> Row:
    runs = result.runs
    seconds, middle = runs.seconds[quantity], runs.median(quantity)
    per_second = result.flops[quantity] / middle if middle else None
    return {
        **asdict(m),
        "quantity": quantity,
        "status": runs.status,
        "runs": len(seconds),
        "seconds": middle,
        "seconds_min": min(seconds) if middle else None,
        "first_seconds": runs.first_seconds,
        "scenes_per_s": m.scenes / middle if middle else None,
        "triangles_per_s": m.scenes * m.triangles / middle if middle else None,
        "tokens_per_s": result.tokens / middle if middle else None,
        "peak_GB": runs.peak / GB if runs.peak and middle else None,
        "TFLOP": result.flops[quantity] / 1e12,
        "TFLOP_per_s": per_second and per_second / 1e12,
        "of_peak": per_second / peak if per_second and peak else None,
        "of_matrix_rate": per_second and per_second / rate,
        "matrix_TFLOP_per_s": rate / 1e12,
        "published_TFLOP_per_s": peak and peak / 1e12,
    }


def _measured(wanted: Mapping[str, Any], known: Sequence[Mapping[str, Any]]) -> bool:
    return any(all(str(row.get(name)) == str(value) for name, value in wanted.items()) for row in known)
