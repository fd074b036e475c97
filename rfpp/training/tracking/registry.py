"""Resolve names in MLflow's model registry to checkpoint files."""

from __future__ import annotations

import re
from pathlib import Path

from rfpp.errors import CheckpointError


def checkpoint_file(checkpoint: str, tracking_uri: str | None, folder: Path) -> str:
    """The file of a registered model: `models:/<name>/<version>`, `models:/<name>/latest` or `models:/<name>@<alias>`.

    Args:
        checkpoint: anything else is returned as it is.
        tracking_uri: of the MLflow server, or None for the store in `folder`.
        folder: fetched to its `registered/<name>/<version>/checkpoints`, like the run folder of a training here.

    Raises:
        CheckpointError: there is no such model, or it cannot be fetched.
    """
    if not checkpoint.startswith("models:/"):
        return checkpoint
    if not (parts := re.fullmatch(r"models:/([^/@]+)(?:/(\d+|latest)|@([^/@]+))", checkpoint)):
        raise CheckpointError(
            f"{checkpoint}: write models:/<name>/<version>, models:/<name>/latest or models:/<name>@<alias>"
        )
    from rfpp.training.tracking.models import fetched  # late: only who names such a model needs MLflow

    return str(fetched(*parts.groups(), tracking_uri, folder))
