"""The summary printed when training ends."""

from __future__ import annotations

from pathlib import Path

from rfpp.metrics.image import METRICS
from rfpp.training.tracking.journal import JOURNAL, records
from rfpp.training.tracking.run_logger import RunLogger


def end_summary(logger: RunLogger, checkpoint: Path, data_root: str, monitor: str) -> str:
    """Summary at the end: best validation score, its checkpoint, tracking, and commands to evaluate and render.

    Args:
        checkpoint: the best one.
        monitor: the metric it is best in, the lower the better, e.g. "validation/log_l1".
    """
    validations = [
        record
        for record, _ in records(logger.run_dir / JOURNAL)
        if record["kind"] == "metrics" and monitor in record["values"]
    ]
    lines = []
    if validations:
        best = min(validations, key=lambda record: record["values"][monitor])
        scores = ", ".join(
            f"{metric.label} {best['values'][f'validation/{name}']:.{metric.decimals}f}"
            for name, metric in METRICS.items()
            if f"validation/{name}" in best["values"]
        )
        lines.append(f"Best     step {best['step'] + 1}: {scores}")
    lines.append(f"Written  {checkpoint}")
    if logger.registered_model:
        lines.append(f"Model    {logger.registered_model}")
    lines += [
        logger.whereabouts,
        f"Evaluate python launch/evaluate.py data.root={data_root} checkpoint={checkpoint}",
        f"Render   python launch/render.py scene=data/scenes/cornell_box.json checkpoint={checkpoint}",
    ]
    return "\n".join(lines)
