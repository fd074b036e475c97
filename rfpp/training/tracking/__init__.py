"""Experiment tracking: one run per run folder, in MLflow or in the folder alone.

`logger` and `local` are Lightning's ways in, `journal` what both write, `sending` how that comes to MLflow. Nothing
imports MLflow but what talks to it: `logger`, `sending`, `store`, `models`, `datasets`.
"""

from rfpp.training.tracking.description import code_version
from rfpp.training.tracking.logged_results import log_results

__all__ = ["code_version", "log_results"]
