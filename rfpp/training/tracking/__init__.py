"""Experiment tracking: one run per run folder, in MLflow or in the folder alone.

Both loggers write a journal in the run's folder, so that no metric is lost when a process is killed or the server is
away, and a resumed run logs no step twice. `sending` transfers the journal to MLflow in the background. Lightning's
MLFlowLogger cannot do this: it queues metrics in memory and waits for the server.
"""

from rfpp.training.tracking.description import code_version
from rfpp.training.tracking.registry import log_results

__all__ = ["code_version", "log_results"]
