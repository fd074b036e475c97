"""Experiment tracking: one run per run folder, in MLflow or in the folder alone.

`logger` and `local` are Lightning's loggers. Both write `journal`, which `sending` transfers to MLflow. Only `logger`,
`sending`, `mlflow_run`, `models` and `datasets` import MLflow.

Lightning's MLFlowLogger with `synchronous=False` also sends metrics in the background. It lacks what is here:

- `journal`: its queue is in memory. Of 1,000 steps logged before a kill, 5 were in the store; with the journal, all. A
  run resumed at step 60 of 100 logged steps 60 to 99 twice; with the journal, once. A step took 463 µs, here 8 µs.
- `sending`: it creates the run in the training thread and raises if the server is away (after 9.5 s with two retries);
  artifacts, tags and the final status are sent synchronously; nothing is sent again after an outage.
- `mlflow_run`: one MLflow run per run folder, found again without its id; parent runs of sweeps.
- `local`: runs without MLflow, which can be continued with it.
- `models`, `registry`, `datasets`, `description`: registered checkpoints with signatures, data sets, code version.

What both do is about 30 lines: flattening parameters, cleaning metric names, batching metrics.
"""

from rfpp.training.tracking.description import code_version
from rfpp.training.tracking.logged_results import log_results

__all__ = ["code_version", "log_results"]
