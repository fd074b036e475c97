"""evaluation.json: all that a table of results must know about one evaluation of one checkpoint."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from rfpp.checkpoint.loading import CheckpointInfo
from rfpp.errors import UserError
from rfpp.evaluation.measuring.confidence import Estimate, Estimates
from rfpp.evaluation.measuring.training_cost import TrainingCost
from rfpp.files import write_atomically
from rfpp.metrics.image import METRICS
from rfpp.shards.manifest import Manifest
from rfpp.training.tracking.description import hardware

EVALUATION_FILE = "evaluation.json"


@dataclass(frozen=True)
class Evaluation:
    """What one checkpoint, and the trivial baselines beside it, scored on one data set.

    Attributes:
        method, trained_on, seed, steps, commit: of the checkpoint; its data set by name.
        data, data_manifest: name and hash of the data set it was evaluated on.
        hardware: it was evaluated on.
        definitions: by metric name: the formula with its tone map and epsilon.
        means: by split, predictor ("model" or a baseline's name) and metric.
        cost: of training, where it is known.
        life: by split, see `rfpp.evaluation.measuring.signs_of_life`; empty in evaluations that were made without.
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
    cost: TrainingCost | None = None
    life: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        info: CheckpointInfo,
        manifest: Manifest,
        device: torch.device,
        means: Mapping[tuple[str, str], Estimates],
        cost: TrainingCost | None = None,
        life: Mapping[str, Mapping[str, float]] | None = None,
    ) -> Evaluation:
        """Of the checkpoint that `info` describes, on the data of `manifest`, computed on `device`."""
        measured = {name for values in means.values() for name in values}
        return cls(
            method=info.method,
            trained_on=info.dataset,
            seed=info.seed,
            steps=info.steps,
            commit=info.commit,
            data=manifest.name,
            data_manifest=manifest.hash,
            hardware=hardware(device),
            definitions={name: metric.definition for name, metric in METRICS.items() if name in measured},
            means=means,
            cost=cost,
            life=life or {},
        )

    @classmethod
    def read(cls, path: Path) -> Evaluation:
        """Raises UserError naming the file: absent, unreadable, or not an evaluation."""
        try:
            content = json.loads(path.read_bytes())
            splits = content.pop("splits")
            means = {
                (split, predictor): {name: _estimate(numbers) for name, numbers in values.items()}
                for split, predictors in splits.items()
                for predictor, values in predictors.items()
            }
            cost = content.pop("cost", None)
            return cls(**content, means=means, cost=cost and TrainingCost(**cost))
        except OSError as error:
            raise UserError(f"{path}: cannot be read ({error.strerror}): correct the path") from None
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{path}: not an evaluation ({error!r}): make it again with launch/evaluate.py") from None

    def write(self, folder: Path) -> Path:
        """Write evaluation.json into `folder`; returns its path. Raises UserError: it cannot be written."""
        splits: dict[str, dict[str, Any]] = defaultdict(dict)
        for (split, predictor), values in self.means.items():
            splits[split][predictor] = {name: _numbers(estimate) for name, estimate in values.items()}
        about = {key: value for key, value in asdict(self).items() if key != "means"}
        text = json.dumps({**about, "splits": splits}, indent=1, allow_nan=False)
        return write_atomically(folder / EVALUATION_FILE, text.encode())


def read_evaluations(paths: Iterable[Path]) -> list[Evaluation]:
    """The evaluations in these files and anywhere beneath these folders, all fit to stand in one table.

    Copies of a file, such as MLflow keeps, count once.

    Raises:
        UserError: nothing is found, a file is not an evaluation, a metric was not what it is now, or two files must not
            be compared: one data set in two versions, or one network (method, training, seed) twice on the same data.
    """
    files: dict[bytes, Path] = {}
    for path in paths:
        found = sorted(path.rglob(EVALUATION_FILE)) if path.is_dir() else [path]
        if not found:
            raise UserError(f"{path}: no {EVALUATION_FILE} anywhere beneath: make one with launch/evaluate.py")
        for file in found:
            files.setdefault(file.read_bytes() if file.is_file() else b"", file)
    evaluations = {file: Evaluation.read(file) for file in files.values()}
    _require_comparable(evaluations)
    return list(evaluations.values())


def require_known_metrics(evaluation: Evaluation, path: Path) -> None:
    """Raises UserError naming the file: what it calls by a metric's name is another metric by now."""
    for name, definition in evaluation.definitions.items():
        if name not in METRICS or METRICS[name].definition != definition:
            raise UserError(f"{path}: '{name}' is by now another metric ({definition}): evaluate again")


def _require_comparable(evaluations: Mapping[Path, Evaluation]) -> None:
    seen: dict[str, tuple[Path, str]] = {}
    for file, e in evaluations.items():
        require_known_metrics(e, file)
        for what, version in ((f"the data set '{e.data}'", e.data_manifest), (_identity(e), str(file))):
            other, known = seen.setdefault(what, (file, version))
            if known != version:
                raise UserError(f"{file}: {what} is not the same here as in {other}: give only one of the two")


def _identity(e: Evaluation) -> str:
    return f"{e.method} (trained on {e.trained_on}, {e.steps} steps, seed {e.seed}, commit {e.commit}) on '{e.data}'"


def _numbers(estimate: Estimate) -> dict[str, float | str]:
    """JSON has no NaN and no infinity: they are written as words, which `float` understands."""
    return {key: value if math.isfinite(value) else str(value) for key, value in asdict(estimate).items()}


def _estimate(numbers: Mapping[str, Any]) -> Estimate:
    return Estimate(*(float(numbers[key]) for key in ("mean", "low", "high")), scenes=int(numbers["scenes"]))
