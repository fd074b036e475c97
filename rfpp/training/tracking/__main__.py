"""Send the journals of runs that ended while the MLflow server was unreachable.

python -m rfpp.training.tracking <run folder> …
"""

from __future__ import annotations

import sys
from pathlib import Path

from rfpp.errors import UserError
from rfpp.training.tracking.sending import Sender


def main(folders: list[str]) -> int:
    """Send journals; returns the exit status, 1 if something could not be sent."""
    status = 0
    for folder in folders:
        try:
            sender = Sender(Path(folder))
            sender.send()
            print(f"{folder}: MLflow run {sender.target.run_id} in {sender.target.tracking_uri} is complete")
        except UserError as error:
            print(f"error: {error}", file=sys.stderr)
            status = 1
        except Exception as error:  # of MLflow's, whose kinds are many
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            print(f"error: {folder}: cannot be sent to {sender.target.tracking_uri} ({reason})", file=sys.stderr)
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
