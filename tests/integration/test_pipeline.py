"""Scenes → Blender → shards → training → evaluation → pictures, as a user runs it, only smaller."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from marks import requires_blender
from mlflow.tracking import MlflowClient

from rfpp import Renderer
from rfpp.checkpoint.loading import load_network
from rfpp.commands import CONFIG_DIR
from rfpp.imaging.exr import read_exr
from rfpp.scene.io.loading import load_scene

pytestmark = requires_blender

CORNELL_BOX = CONFIG_DIR.parent / "data" / "scenes" / "cornell_box.json"


@pytest.fixture(scope="module")
def trained(tmp_path_factory, composed, rendered_data):
    """(checkpoint, run folder, MLflow client): twelve steps of quickstart's own training."""
    from launch.train import main

    folder = tmp_path_factory.mktemp("runs")
    cfg = composed(
        "train", "experiment=quickstart", "debug=cpu", f"data.root={rendered_data}", "steps=12",
        f"run_dir={folder}/quickstart/one", f"logger.folder={folder}", "trainer.val_check_interval=6",
        "callbacks.panels.scenes=1", "loss.lpips_weight=0.0", "schedule.warmup_steps=2",
    )  # fmt: skip
    checkpoint = main.__wrapped__(cfg)
    return checkpoint, folder / "quickstart" / "one", MlflowClient(f"sqlite:///{folder}/mlflow.db")


def test_training_leaves_checkpoints_config_and_pictures(trained):
    checkpoint, run, _ = trained
    assert checkpoint == run / "checkpoints" / "best.ckpt"
    assert (run / "checkpoints" / "last.ckpt").is_file()
    assert (run / "config.yaml").is_file()
    assert (run.parent / "latest").resolve() == run.resolve()
    assert len(list((run / "panels").glob("panels-*.png"))) == len(list((run / "panels").glob("bounces-*.png"))) == 2


def test_mlflow_knows_losses_consistency_config_versions_and_pictures(trained):
    checkpoint, _, client = trained
    _, info = load_network(checkpoint)
    run = client.get_run(info.mlflow_run_id)
    expected = {"train/loss", "train/l1", "train/gradient_norm", "validation/log_l1", "validation/ssim"}
    expected |= {f"consistency/k{k}" for k in range(1, 4)} | {"throughput/images_per_s", "train/learning_rate"}
    assert expected <= run.data.metrics.keys()
    assert len(client.get_metric_history(run.info.run_id, "train/loss")) == 12
    assert run.data.params["model.transport.iterations"] == "3"
    assert run.data.tags["data_manifest"] == info.data_manifest
    assert run.data.tags["code_version"]
    assert [a.path for a in client.list_artifacts(run.info.run_id, "config")] == ["config/config.yaml"]
    assert len(client.list_artifacts(run.info.run_id, "panels")) == 4


def test_checkpoints_hold_the_network_alone(trained):
    content = torch.load(trained[0], weights_only=True)
    assert all(key.startswith("network.") for key in content["state_dict"])


def test_evaluation_writes_tables_and_reports_to_the_training_run(trained, composed, rendered_data):
    from launch.evaluate import main

    checkpoint, run, client = trained
    cfg = composed(
        "evaluate", "experiment=quickstart", f"data.root={rendered_data}", f"checkpoint={checkpoint}",
        "evaluation.lpips=false", "device=cpu",
    )  # fmt: skip
    (evaluation,) = main.__wrapped__(cfg)
    means = evaluation.means
    assert {split for split, _ in means} == {"train_newviews", "test"}
    baselines = {"black", "mean image", "albedo x constant", "direct light", "direct light and reflections"}
    assert {predictor for _, predictor in means} == {"model", *baselines}
    assert all(np.isfinite(row["log_l1"].mean) for row in means.values())
    assert (run / "evaluation" / "summary.csv").is_file()
    run_id = load_network(checkpoint)[1].mlflow_run_id
    logged = client.get_run(run_id).data.metrics
    assert logged["test/log_l1"] == pytest.approx(means["test", "model"]["log_l1"].mean)
    [folder] = [entry.path for entry in client.list_artifacts(run_id) if entry.path.startswith("evaluation")]
    sent = {Path(entry.path).name: entry.file_size for entry in client.list_artifacts(run_id, folder)}
    here = {path.name: path.stat().st_size for path in (run / "evaluation").iterdir()}
    assert {"report.html", "scenes.csv", "summary.csv", "test.png"} <= sent.keys()
    assert sent == {name: here[name] for name in sent}


def test_render_writes_exr_png_reference_and_comparison(trained, composed, tmp_path, capsys):
    from launch.render import main

    cfg = composed(
        "render", f"scene={CORNELL_BOX}", f"checkpoint={trained[0]}", f"output={tmp_path}/box.exr", "cameras=[1]",
        "resolution=[32,48]", "reference=true", "reference_settings=preview", "device=cpu",
    )  # fmt: skip
    assert main.__wrapped__(cfg) == [tmp_path / "box.exr"]
    names = {path.name for path in tmp_path.iterdir()}
    pictures = {"box.exr", "box.png", "box_reference.exr", "box_reference.png", "box_comparison.png"}
    assert pictures <= names
    image = read_exr(tmp_path / "box.exr")["RGB"]
    reference = read_exr(tmp_path / "box_reference.exr")["RGB"]
    assert image.shape == reference.shape == (32, 48, 3)
    assert reference.mean() > 0.02
    same = Renderer.load(trained[0], "cpu").render(load_scene(CORNELL_BOX), (32, 48))[1]
    np.testing.assert_allclose(image, same, rtol=2e-3, atol=1e-4)


def test_training_refuses_a_damaged_shard_and_names_it(trained, composed, rendered_data, tmp_path, capsys):
    import shutil

    from launch.train import main

    root = shutil.copytree(rendered_data, tmp_path / "damaged")
    shard = json.loads((root / "manifest.json").read_text())["splits"]["train"][0]["file"]
    content = bytearray((root / shard).read_bytes())
    content[len(content) // 2] ^= 1
    (root / shard).write_bytes(content)
    cfg = composed(
        "train", "experiment=quickstart", "debug=cpu", f"data.root={root}", "loss.lpips_weight=0.0",
        f"run_dir={tmp_path}/run", "logger=none",
    )  # fmt: skip
    with pytest.raises(SystemExit) as stop:
        main.__wrapped__(cfg)
    assert stop.value.code == 1
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert shard in message
    assert "sha256" in message
