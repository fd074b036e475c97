"""Notebooks run from their first cell to their last, and are kept without what they printed."""

import json
from pathlib import Path

import nbformat
import pytest
from marks import requires_blender
from nbclient import NotebookClient
from small_data import make
from training_runs import train

from rfpp.training.tracking.mlflow_run import store_uri

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.fixture(scope="module")
def parameters(tmp_path_factory) -> dict:
    """Values for all notebooks' parameters: a data set, and a run on it of a few steps."""
    folder = tmp_path_factory.mktemp("notebooks")
    make(folder / "data", resolution=16, splits={"train": 4, "validation": 1})
    (folder / "runs").mkdir()
    train(
        folder / "runs" / "run", folder / "data", "data.resolution=16", "steps=4", "trainer.val_check_interval=2",
        "callbacks.checkpoints.every_n_steps=2",
    )  # fmt: skip
    return {
        "ROOT": str(ROOT),
        "SHARDS": str(folder / "data"),
        "SCENE": str(ROOT / "data" / "scenes" / "cornell_box.json"),
        "STORE": store_uri(folder / "runs"),
        "OUTPUT": str(folder / "renders"),
        "RESOLUTION": 16,
        "STEPS": 4,
    }


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_is_kept_without_outputs(path):
    cells = json.loads(path.read_text())["cells"]
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells), "strip its outputs"


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=requires_blender if "reference" in p.stem else ()) for p in NOTEBOOKS],
    ids=lambda path: path.stem,
)
def test_runs_and_shows_pictures(path, parameters):
    notebook = nbformat.read(path, as_version=4)
    [own] = [cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", [])]
    names = [name for name in parameters if f"{name} = " in own.source]
    assert names
    if path.stem.startswith("5"):
        names.remove("SCENE")  # it makes its own
    own.source += "".join(f"\n{name} = {parameters[name]!r}" for name in names)
    NotebookClient(notebook, timeout=300, kernel_name="python3").execute(cwd=path.parent)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs)
