"""launch/evaluate.py from a checkpoint on disk to its files."""

import csv

import pytest
import torch
from hydra import compose, initialize_config_dir
from networks import checkpoint_info
from omegaconf import OmegaConf

from launch.evaluate import main
from rfpp.entry import CONFIG_DIR
from rfpp.inference.checkpoint import CHECKPOINT_KEY, NETWORK_PREFIX, build
from rfpp.shards.manifest import Manifest


@pytest.fixture
def compose_evaluation(data_root):
    def composed(*overrides: str):
        with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
            small = ["size.width=48", "size.heads=1", "size.hidden=64", "size.frequencies=2"]
            where = [f"data.root={data_root}", "evaluation.splits=[test]", "evaluation.lpips=false", "device=cpu"]
            return compose("evaluate", [*small, *where, *overrides])

    return composed


@pytest.fixture
def checkpoint(compose_evaluation, data_root, tmp_path):
    """An untrained small network, saved as training saves it."""
    model = OmegaConf.to_container(compose_evaluation().model, resolve=True)
    info = checkpoint_info(model, data_manifest=Manifest.load(data_root).hash)
    state = {NETWORK_PREFIX + key: value for key, value in build(model, "test").state_dict().items()}
    path = tmp_path / "run" / "checkpoints" / "best.ckpt"
    path.parent.mkdir(parents=True)
    torch.save({CHECKPOINT_KEY: info.to_dict(), "state_dict": state}, path)
    return path


def test_writes_tables_and_panels_into_the_run(compose_evaluation, checkpoint, capsys) -> None:
    means = main.__wrapped__(compose_evaluation(f"checkpoint={checkpoint}"))
    folder = checkpoint.parents[1] / "evaluation"
    written = {path.name for path in folder.iterdir()}
    assert written == {"test.csv", "test_scenes.csv", "summary.csv", "test.png", "config.yaml"}
    rows = {row["predictor"]: row for row in csv.DictReader((folder / "summary.csv").open())}
    assert float(rows["model"]["psnr"]) == pytest.approx(means["test", "model"]["psnr"], rel=1e-5)
    printed = capsys.readouterr().out
    assert "albedo x constant" in printed
    assert "another data set" not in printed


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("name=unchanged", "checkpoint is not given"),
        ("checkpoint=/nowhere/best.ckpt", "/nowhere/best.ckpt: no such checkpoint"),
    ],
)
def test_a_bad_checkpoint_is_one_line(compose_evaluation, capsys, override, message) -> None:
    with pytest.raises(SystemExit) as stop:
        main.__wrapped__(compose_evaluation(override))
    assert stop.value.code == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
