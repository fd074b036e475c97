import csv
import shutil
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from networks import checkpoint_info
from omegaconf import OmegaConf

from launch.evaluate import main
from rfpp.checkpoint.loading import CHECKPOINT_KEY, NETWORK_PREFIX
from rfpp.checkpoint.network_building import build
from rfpp.commands import CONFIG_DIR
from rfpp.evaluation.measuring.evaluation_file import read_evaluations
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
def make_checkpoint(compose_evaluation, data_root, tmp_path):
    """`make_checkpoint(run)`: an untrained small network, saved as in training, in the folder of a run."""

    def made(run: str, **about) -> Path:
        model = OmegaConf.to_container(compose_evaluation().model, resolve=True)
        manifest = Manifest.load(data_root)
        info = checkpoint_info(model, **{"data_manifest": manifest.hash, "dataset": manifest.name, **about})
        state = {NETWORK_PREFIX + key: value for key, value in build(model, "test").state_dict().items()}
        path = tmp_path / run / "checkpoints" / "best.ckpt"
        path.parent.mkdir(parents=True)
        torch.save({CHECKPOINT_KEY: info.to_dict(), "state_dict": state}, path)
        return path

    return made


def _summary(folder: Path) -> dict[str, dict[str, str]]:
    return {row["predictor"]: row for row in csv.DictReader((folder / "summary.csv").open())}


def test_writes_tables_and_panels_into_the_run(compose_evaluation, make_checkpoint, capsys) -> None:
    checkpoint = make_checkpoint("run", method="RenderFormer++ w/o TCL", seed=3)
    (evaluation,) = main.__wrapped__(compose_evaluation(f"checkpoint={checkpoint}"))
    folder = checkpoint.parents[1] / "evaluation"
    written = {path.name for path in folder.iterdir()}
    tables = {"images.csv", "scenes.csv", "summary.csv", "evaluation.json"}
    assert written == {*tables, "test.png", "report.html", "config.yaml"}
    assert read_evaluations([folder]) == [evaluation]
    assert (evaluation.method, evaluation.seed, evaluation.data) == ("RenderFormer++ w/o TCL", 3, "known")
    psnr = evaluation.means["test", "model"]["psnr"]
    assert psnr.scenes == 3
    assert psnr.low < psnr.mean < psnr.high
    assert float(_summary(folder)["model"]["psnr_high"]) == pytest.approx(psnr.high, rel=1e-5)
    printed = capsys.readouterr().out
    assert "albedo x constant" in printed
    assert "test: log-L1 with another scene's tokens" in printed
    assert set(evaluation.ablation["test"]) == {"other_tokens", "other_encoded_tokens", "no_operator"}
    assert len(evaluation.transport["test"]["residual"]) == 7
    assert "another data set" not in printed


def test_several_checkpoints_share_their_baselines(compose_evaluation, make_checkpoint, capsys) -> None:
    first, second = make_checkpoint("a", seed=1), make_checkpoint("b", seed=2, dataset="other", data_manifest="other")
    evaluations = main.__wrapped__(compose_evaluation(f"checkpoint=[{first},{second}]"))
    assert [e.seed for e in evaluations] == [1, 2]
    folders = [first.parents[1] / "evaluation", second.parents[1] / "evaluation_known"]
    summaries = [_summary(folder) for folder in folders]
    assert summaries[0]["model"] != summaries[1]["model"]
    assert summaries[0]["black"] == summaries[1]["black"]
    assert capsys.readouterr().out.count("another data set") == 1


def test_radiosity_is_evaluated_like_a_checkpoint(compose_evaluation, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (evaluation,) = main.__wrapped__(compose_evaluation("checkpoint=radiosity"))
    model, black = (evaluation.means["test", who]["log_l1"] for who in ("model", "black"))
    assert model.scenes == black.scenes == 3
    assert model.mean != black.mean
    assert evaluation.ablation == evaluation.transport == {}
    folder = tmp_path / "data" / "runs" / "radiosity" / "evaluation_known"
    tables = {"images.csv", "scenes.csv", "summary.csv", "evaluation.json"}
    assert {path.name for path in folder.iterdir()} == {*tables, "test.png", "report.html", "config.yaml"}
    assert "Transport" not in (folder / "report.html").read_text()


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("name=unchanged", "checkpoint is not given"),
        ("checkpoint=/nowhere/best.ckpt", "/nowhere/best.ckpt: no such checkpoint"),
        ("checkpoint=[{run}/checkpoints/best.ckpt,/nowhere/best.ckpt]", "/nowhere/best.ckpt: no such checkpoint"),
        ("checkpoint=[{run}/checkpoints/best.ckpt,{run}/checkpoints/last.ckpt]", "write to one folder"),
    ],
)
def test_a_bad_setting_is_one_line_before_anything_is_evaluated(
    compose_evaluation, make_checkpoint, capsys, override, message
) -> None:
    best = make_checkpoint("run")
    shutil.copy(best, best.with_name("last.ckpt"))
    run = best.parents[1]
    with pytest.raises(SystemExit) as stop:
        main.__wrapped__(compose_evaluation(override.format(run=run)))
    assert stop.value.code == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert [path.name for path in run.iterdir()] == ["checkpoints"]
