"""What is learnt of a run after it has ended."""

from __future__ import annotations

from pathlib import Path

from rfpp.training.tracking.store import connected


def log_results(tracking_uri: str, run_id: str, metrics: dict[str, float], files: dict[Path, str]) -> None:
    """Add metrics, and files by artifact folder, to a run that has ended."""
    client = connected(tracking_uri)
    for name, value in metrics.items():
        client.log_metric(run_id, name, value)
    for file, folder in files.items():
        client.log_artifact(run_id, str(file), folder)
