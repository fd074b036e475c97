"""evaluation.json: one evaluation of one checkpoint, as read by the tables of results."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
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
    """Scores of one checkpoint and the trivial baselines on one data set.

    Attributes:
        method, trained_on, seed, steps, commit: of the checkpoint; its data set by name.
        data, data_manifest: name and hash of the data set it was evaluated on.
        hardware: it was evaluated on.
        definitions: by metric name: the formula with its tone map and epsilon.
        means: by split, predictor ("model" or a baseline's name) and metric.
        cost: of training, where it is known.
        life: by split, see `rfpp.evaluation.measuring.disabled_parts`; empty in evaluations that were made without.
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
        with reading(path):
            return cls.from_json(json.loads(path.read_bytes()))

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Evaluation:
        """Inverse of `to_json`. Raises ValueError, KeyError, TypeError or AttributeError for anything else."""
        rest = {key: value for key, value in content.items() if key not in ("splits", "cost")}
        means = {
            (split, predictor): {name: _estimate(numbers) for name, numbers in values.items()}
            for split, predictors in content["splits"].items()
            for predictor, values in predictors.items()
        }
        cost = content.get("cost")
        return cls(**rest, means=means, cost=cost and TrainingCost(**cost))

    def to_json(self) -> dict[str, Any]:
        """Nested dictionaries of text, numbers and None."""
        splits: dict[str, dict[str, Any]] = defaultdict(dict)
        for (split, predictor), values in self.means.items():
            splits[split][predictor] = {name: _numbers(estimate) for name, estimate in values.items()}
        return {**{key: value for key, value in asdict(self).items() if key != "means"}, "splits": dict(splits)}

    def write(self, folder: Path) -> Path:
        """Write evaluation.json into `folder`; returns its path. Raises UserError: it cannot be written."""
        text = json.dumps(self.to_json(), indent=1, allow_nan=False)
        return write_atomically(folder / EVALUATION_FILE, text.encode())


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turns errors inside the block into a UserError that names the file."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}): correct the path") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"{path}: not an evaluation ({error!r}): make it again with launch/evaluate.py") from None


def require_known_metrics(evaluation: Evaluation, path: Path) -> None:
    """Raises UserError naming the file if the definition of one of its metrics has changed."""
    for name, definition in evaluation.definitions.items():
        if name not in METRICS or METRICS[name].definition != definition:
            raise UserError(f"{path}: '{name}' is by now another metric ({definition}): evaluate again")


def _numbers(estimate: Estimate) -> dict[str, float | str]:
    """JSON has no NaN and no infinity: they are written as words, which `float` understands."""
    return {key: value if math.isfinite(value) else str(value) for key, value in asdict(estimate).items()}


def _estimate(numbers: Mapping[str, Any]) -> Estimate:
    return Estimate(*(float(numbers[key]) for key in ("mean", "low", "high")), scenes=int(numbers["scenes"]))
