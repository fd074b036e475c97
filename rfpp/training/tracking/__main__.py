"""Send the journals of runs that ended while the MLflow server was unreachable.

python -m rfpp.training.tracking <run folder> …
"""

from __future__ import annotations

import sys
from pathlib import Path

from rfpp.errors import UserError
from rfpp.training.tracking.registry import first_line
from rfpp.training.tracking.sending import Sender


def main(folders: list[str]) -> int:
    """Send journals; return the exit status, 1 if one could not be sent."""
    status = 0
    for folder in folders:
        try:
            sender = Sender(Path(folder))
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


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
