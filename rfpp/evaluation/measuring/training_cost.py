"""Time and memory of a training run, from its journal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rfpp.training.tracking.journal import JOURNAL, records


@dataclass(frozen=True)
class TrainingCost:
    """Time and memory of one step on the training machine.

    Attributes:
        seconds: the median, time that the loader was waited for included.
        memory: the most, in GiB: of a GPU what PyTorch allocated, else what the process held, its loaders left out.
    """

    seconds: float
    memory: float

    @classmethod
    def of_run(cls, folder: Path) -> TrainingCost | None:
        """The cost of the training in this folder; None without a journal (an imported network)."""
        journal = folder / JOURNAL
        if not journal.is_file():
            return None
        values = [record["values"] for record, _ in records(journal) if record["kind"] == "metrics"]
        rates = [v["throughput/steps_per_s"] for v in values if "throughput/steps_per_s" in v]
        memory = [v[name] for v in values for name in ("memory/peak", "memory/resident") if name in v]
        return cls(float(1 / np.median(rates)), float(max(memory))) if rates and memory else None
