"""MLflow: one run per run folder, with everything needed to know later what it was.

`logger` is Lightning's way in, `journal` what it writes, `sending` how that comes to MLflow.
"""

from rfpp.training.tracking.description import code_version
from rfpp.training.tracking.results import log_results

__all__ = ["code_version", "log_results"]
