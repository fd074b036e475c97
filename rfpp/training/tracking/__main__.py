"""Send the journals of runs that ended while the MLflow server was unreachable; mark killed runs.

python -m rfpp.training.tracking <run folder> …
"""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

from rfpp.errors import UserError
from rfpp.training.run import RunningError, locked
from rfpp.training.tracking.journal import JOURNAL, Journal, records
from rfpp.training.tracking.registry import first_line
from rfpp.training.tracking.sending import Sender


def main(folders: list[str]) -> int:
    """Send journals; return the exit status, 1 if one could not be sent."""
    status = 0
    for folder in folders:
        try:
            sender = Sender(Path(folder))
            _mark_killed(sender.run_dir)
            sender.send()
            print(f"{folder}: MLflow run {sender.mlflow_run.run_id} in {sender.mlflow_run.tracking_uri} is complete")
        except UserError as error:
            print(f"error: {error}", file=sys.stderr)
            status = 1
        except Exception as error:  # MLflow raises exceptions of many libraries
            reason = f"cannot be sent to {sender.mlflow_run.tracking_uri} ({first_line(error)})"
            print(f"error: {folder}: {reason}", file=sys.stderr)
            status = 1
    return status


def _mark_killed(run_dir: Path) -> None:
    """Record the end of a run whose process died without recording it."""
    statuses = [record["value"] for record, _ in records(run_dir / JOURNAL) if record["kind"] == "status"]
    if statuses[-1:] == ["RUNNING"]:
        with suppress(RunningError), locked(run_dir):
            Journal(run_dir / JOURNAL).append("status", value="KILLED")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
