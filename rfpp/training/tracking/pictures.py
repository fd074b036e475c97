"""Pictures for MLflow's image charts, which have a slider over steps."""

from __future__ import annotations

from pathlib import Path

from mlflow import MlflowClient
from PIL import Image

from rfpp.training.tracking.journal import Record


def log_picture(client: MlflowClient, run_id: str, path: Path, record: Record) -> None:
    """Log a PNG file under the record's name and step, unless MLflow has it: pictures sent twice would show twice."""
    name, step, written = record["name"], record["step"], record["time"]
    there = f"images/{name.replace('/', '~')}+step+{step}+timestamp+{written}+"  # as MLflow names the file
    if not any(artifact.path.startswith(there) for artifact in client.list_artifacts(run_id, "images")):
        with Image.open(path) as image:
            client.log_image(run_id, image, key=name, step=step, timestamp=written)
