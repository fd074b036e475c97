"""evaluation.json: the evaluation of one checkpoint, as read by tables and model cards."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from rfpp.checkpoint.loading import CheckpointInfo
from rfpp.errors import UserError
from rfpp.evaluation.measuring.confidence import Estimate, Estimates
from rfpp.files import write_atomically
from rfpp.metrics.image import METRICS
from rfpp.shards.manifest import Manifest
from rfpp.training.tracking.description import hardware

EVALUATION_FILE = "evaluation.json"


@dataclass(frozen=True)
class Evaluation:
    """Scores of one checkpoint and the trivial baselines on one data set.

    Attributes:
        definitions: Formula with tone map and epsilon, by metric name.
        means: Estimates by (split, predictor), then by metric name.
        ablation: Growth of log-L1 by split and ablation (`rfpp.losses.ablation`).
        transport: Residual and log-L1 after each application of the operator, by split.
    """

    method: str
    trained_on: str
    seed: int
    steps: int | None
    commit: str | None
    data: str
    data_manifest: str
    hardware: str
    definitions: Mapping[str, str]
    means: Mapping[tuple[str, str], Estimates]
    ablation: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    transport: Mapping[str, Mapping[str, Sequence[float]]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        info: CheckpointInfo,
        manifest: Manifest,
        device: torch.device,
        means: Mapping[tuple[str, str], Estimates],
        **measured: Mapping[str, Any],
    ) -> Evaluation:
        """Describe the checkpoint of `info` on the data of `manifest`, computed on `device`."""
        names = {name for values in means.values() for name in values}
        return cls(
            method=info.method,
            trained_on=info.dataset,
            seed=info.seed,
            steps=info.steps,
            commit=info.commit,
            data=manifest.name,
            data_manifest=manifest.hash,
            hardware=hardware(device),
            definitions={name: metric.definition for name, metric in METRICS.items() if name in names},
            means=means,
            **measured,
        )

    @classmethod
    def of_json(cls, content: Any, path: Path) -> Evaluation:
        """Return the evaluation that `to_json` described in a file.

        Raises:
            UserError: If it is not an evaluation, or a metric has changed since.
        """
        try:
            means = {
                (split, predictor): {name: _estimate(numbers) for name, numbers in values.items()}
                for split, predictors in content["splits"].items()
                for predictor, values in predictors.items()
            }
            evaluation = cls(**{key: value for key, value in content.items() if key != "splits"}, means=means)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{path}: not an evaluation ({error!r}): make it again with launch/evaluate.py") from None
        for name, definition in evaluation.definitions.items():
            if name not in METRICS or METRICS[name].definition != definition:
                raise UserError(f"{path}: the definition of '{name}' has changed: evaluate again")
        return evaluation

    def to_json(self) -> dict[str, Any]:
        """Return the evaluation as JSON values."""
        splits: dict[str, dict[str, Any]] = defaultdict(dict)
        for (split, predictor), values in self.means.items():
            splits[split][predictor] = {name: _numbers(estimate) for name, estimate in values.items()}
        return {key: value for key, value in asdict(self).items() if key != "means"} | {"splits": splits}

    def write(self, folder: Path) -> Path:
        """Write evaluation.json into `folder`; return its path."""
        return write_atomically(folder / EVALUATION_FILE, _to_bytes(self.to_json()))


def write_evaluations(evaluations: Sequence[Evaluation], path: Path) -> Path:
    """Write several evaluations into one file, which `read_evaluations` reads; return its path."""
    return write_atomically(path, _to_bytes([evaluation.to_json() for evaluation in evaluations]))


def _read(path: Path) -> list[Evaluation]:
    """Read a file of one or several evaluations. Raises UserError if it is missing or not such a file."""
    try:
        content = json.loads(path.read_bytes())
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}): correct the path") from None
    except ValueError as error:
        raise UserError(f"{path}: not an evaluation ({error!r}): make it again with launch/evaluate.py") from None
    return [Evaluation.of_json(one, path) for one in (content if isinstance(content, list) and content else [content])]


def read_evaluations(paths: Iterable[Path]) -> list[Evaluation]:
    """Read evaluations and check that they are comparable.

    Args:
        paths: Files, or folders that are searched recursively. Copies of an evaluation count once.

    Raises:
        UserError: If nothing is found, a file is not an evaluation, or two files are not comparable: different
            definitions of a metric, two versions of a data set, or one network twice on the same data.
    """
    found: dict[str, tuple[Path, Evaluation]] = {}
    for path in paths:
        files = sorted(path.rglob(EVALUATION_FILE)) if path.is_dir() else [path]
        if not files:
            raise UserError(f"{path}: no {EVALUATION_FILE} in this folder: make one with launch/evaluate.py")
        for file in files:
            for evaluation in _read(file):
                found.setdefault(repr(evaluation), (file, evaluation))
    known: dict[str, tuple[Path, object]] = {}
    for file, e in found.values():
        network = f"{e.method} (trained on {e.trained_on}, {e.steps} steps, seed {e.seed}, commit {e.commit})"
        for what, value in ((f"the data set '{e.data}'", e.data_manifest), (f"{network} on '{e.data}'", file)):
            other, first = known.setdefault(what, (file, value))
            if value != first:
                raise UserError(f"{file}: {what} differs from the one in {other}: omit one of the two files")
    return [evaluation for _, evaluation in found.values()]


def _to_bytes(content: Any) -> bytes:
    return json.dumps(content, indent=1, allow_nan=False).encode()


def _numbers(estimate: Estimate) -> dict[str, float | str]:
    """Convert to JSON numbers; NaN and infinity, which JSON lacks, become words that `float` reads."""
    return {key: value if math.isfinite(value) else str(value) for key, value in asdict(estimate).items()}


def _estimate(numbers: Mapping[str, Any]) -> Estimate:
    return Estimate(*(float(numbers[key]) for key in ("mean", "low", "high")), scenes=int(numbers["scenes"]))
