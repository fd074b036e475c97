"""launch/generate.py as a user runs it."""

import subprocess
import sys
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from marks import requires_blender

from rfpp.shards.job import DatasetSettings
from rfpp.shards.manifest import Manifest

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("experiment", ["quickstart", "small_scale", "large_scale"])
def test_every_experiment_composes_to_a_family_and_valid_data_settings(experiment):
    with initialize_config_dir(str(REPOSITORY / "conf"), version_base="1.3"):
        cfg = compose("generate", [f"+experiment={experiment}"])
    data = instantiate(cfg.data, _convert_="all")
    assert isinstance(data, DatasetSettings)
    assert data.root == f"data/shards/{experiment}"
    assert instantiate(cfg.scene).cameras.count == data.views
    assert instantiate(cfg.reference).denoise


@requires_blender
def test_generate_then_nothing_to_do_then_refused(tmp_path):
    def run(*overrides: str) -> subprocess.CompletedProcess:
        small = ["data.resolution=16", "reference.samples=1", "farm.workers=1"]
        amount = ["data.splits={train: 1, train_newviews: 0, validation: 0, test: 0}"]
        command = [sys.executable, "launch/generate.py", "+experiment=quickstart", f"data.root={tmp_path}"]
        return subprocess.run(
            [*command, *small, *amount, *overrides], cwd=REPOSITORY, capture_output=True, text=True, check=False
        )

    made = run()
    assert made.returncode == 0, made.stderr
    assert "Made 1 scenes" in made.stdout
    assert "images/s" in made.stdout
    assert Manifest.load(tmp_path).counts["images"] == 4
    assert "Nothing to do: all 1 scenes" in run().stdout
    refused = run("reference.samples=2")
    assert refused.returncode == 1
    assert refused.stderr.count("\n") == 1
    assert "reference.samples (1 there, 2 now)" in refused.stderr
