"""A training run in MLflow: metrics, pictures, parameters, and a model to load from there."""

from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from mlflow import MlflowClient
from small_data import make

from rfpp import Renderer
from rfpp.batch import RaggedBatch
from rfpp.checkpoint.loading import load_network
from rfpp.commands import CONFIG_DIR
from rfpp.errors import CheckpointError
from rfpp.losses.ablation import OTHER_TOKENS, TokenFeatures, ablated
from rfpp.losses.log_l1 import log_l1
from rfpp.shards.dataset import ShardSplit
from rfpp.shards.views import select_views
from rfpp.training.tracking.registry import checkpoint_file

STEPS = 4


@pytest.fixture(scope="module")
def tracked(tmp_path_factory):
    """Folder, best checkpoint, client and run of a training."""
    from launch.train import main

    folder = tmp_path_factory.mktemp("tracked")
    data = make(folder / "data", splits={"train": 3, "validation": 2}).root
    overrides = [
        "experiment=quickstart", "debug=cpu", f"data.root={data}", "data.resolution=8", f"steps={STEPS}",
        "trainer.val_check_interval=2", "loss.lpips_weight=0.0", f"run_dir={folder}/run", f"logger.folder={folder}",
        "callbacks.panels.scenes=1", "schedule.warmup_steps=1",
        "size.width=54", "callbacks.tracked.model_name=rfpp-debug", "size.heads=1", "size.hidden=64",
    ]  # fmt: skip
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        cfg = compose("train", overrides=overrides)
    checkpoint = main.__wrapped__(cfg)
    client = MlflowClient(f"sqlite:///{folder}/mlflow.db")
    return folder, checkpoint, client, client.get_run(load_network(checkpoint)[1].mlflow_run_id)


def test_every_step_is_logged(tracked):
    _, _, client, run = tracked
    every_step = {"train/loss", "train/l1", "train/consistency", "train/learning_rate", "train/gradient_norm"}
    every_step |= {"consistency/k1", "consistency/k2", "consistency/k3", "memory/resident"}
    rates = ("steps", "scenes", "images", "triangles", "tokens")
    every_step |= {f"throughput/{name}_per_s" for name in rates}
    every_step.add("throughput/data_wait_fraction")
    for name in every_step:
        steps = [metric.step for metric in client.get_metric_history(run.info.run_id, name)]
        assert steps == list(range(STEPS)), name
    assert run.data.params["plan.precision"] in ("32-true", "bf16-mixed")


def test_parameters_leave_out_what_differs_between_any_two_runs(tracked):
    folder, _, _, run = tracked
    assert {"seed", "optimizer.lr", "data.root"} <= run.data.params.keys()
    own = (f"{folder}/run", run.info.run_name)
    assert not [name for name, value in run.data.params.items() if any(each in value for each in own)]


def test_every_validation_is_scored_and_shown(tracked):
    folder, _, client, run = tracked
    for name in ("log_l1", "l1", "mape", "ssim", "psnr"):
        assert [m.step for m in client.get_metric_history(run.info.run_id, f"validation/{name}")] == [1, 3]
    pictures = {path.name for path in (folder / "run" / "panels").iterdir()}
    assert pictures == {f"{sheet}-00000{step}.png" for sheet in ("panels", "bounces") for step in (2, 4)}
    assert {Path(a.path).name for a in client.list_artifacts(run.info.run_id, "panels")} == pictures


def test_every_validation_measures_the_ablations(tracked):
    """The logged number equals that of the best checkpoint at its step."""
    folder, checkpoint, client, run = tracked
    for name in ("other_tokens", "other_encoded_tokens", "no_operator", "spread"):
        assert [m.step for m in client.get_metric_history(run.info.run_id, f"ablation/{name}")] == [1, 3]
    network, info = load_network(checkpoint)
    network.eval()
    scenes = ShardSplit(folder / "data", "validation")
    views = [select_views(s, range(len(s.fov)), network.gbuffer_channels) for s in (scenes[0], scenes[1])]
    first, second = (RaggedBatch.pack([view]) for view in views)
    with torch.no_grad():
        image = ablated(network, second, TokenFeatures.of(network, first))[OTHER_TOKENS]
        growth = log_l1(image, second.image) / log_l1(network(second).log_radiance, second.image) - 1
    logged = {m.step: m.value for m in client.get_metric_history(run.info.run_id, "ablation/other_tokens")}
    assert logged[info.steps - 1] == pytest.approx(growth.item(), abs=1e-3)


def test_the_run_records_settings_data_and_code(tracked):
    _, checkpoint, client, run = tracked
    assert run.info.status == "FINISHED"
    assert run.data.params["model.transport.iterations"] == "3"
    tags = run.data.tags
    assert {"code_version", "data_manifest", "host", "run_dir"} <= tags.keys()
    assert tags["resumed"] == "0"
    (used,) = run.inputs.dataset_inputs
    assert load_network(checkpoint)[1].data_manifest.startswith(used.dataset.digest)
    assert [a.path for a in client.list_artifacts(run.info.run_id, "config")] == ["config/config.yaml"]
    assert run.info.run_name.startswith("debug, RenderFormer++, seed 0, 20")
    assert tags["mlflow.note.content"].startswith("```\nNetwork ")
    history = client.get_metric_history(run.info.run_id, "validation/log_l1")
    assert run.data.metrics["best/log_l1"] == min(metric.value for metric in history)
    changed = tags["code_version"].endswith("-dirty")
    assert [a.path for a in client.list_artifacts(run.info.run_id, "code")] == ["code/code.diff"] * changed


def test_the_best_checkpoint_is_loaded_from_the_registry(tracked):
    folder, checkpoint, client, run = tracked
    fetched = checkpoint_file("models:/rfpp-debug/1", None, folder)
    ours, registered = (Renderer.load(path, "cpu") for path in (checkpoint, fetched))
    assert registered.info == ours.info
    weights = ours.engine.module.state_dict()
    assert all((weights[name] == value).all() for name, value in registered.engine.module.state_dict().items())
    assert checkpoint_file("models:/rfpp-debug/latest", None, folder) == fetched
    version = client.get_model_version("rfpp-debug", "1")
    assert version.run_id == run.info.run_id


@pytest.mark.parametrize(
    ("uri", "problem"),
    [("models:/rfpp-debug/7", "cannot be fetched"), ("models:/nothing/latest", "no version"), ("models:/x", "write")],
)
def test_a_model_that_is_not_there_is_one_clear_line(tracked, uri, problem):
    with pytest.raises(CheckpointError, match=problem):
        checkpoint_file(uri, None, tracked[0])


def test_a_registered_model_renders(tracked, tmp_path):
    from launch.render import main

    folder = CONFIG_DIR / "render"
    with initialize_config_dir(str(folder), version_base="1.3"):
        overrides = [
            f"scene={CONFIG_DIR.parent}/data/scenes/cornell_box.json", "checkpoint=models:/rfpp-debug/1",
            f"registry.folder={tracked[0]}", f"output={tmp_path}/box.exr", "cameras=[0]", "resolution=8", "device=cpu",
        ]  # fmt: skip
        cfg = compose("render", overrides=overrides)
    assert main.__wrapped__(cfg) == [tmp_path / "box.exr"]
    with pytest.raises(CheckpointError, match=r"checkpoint_file"):
        Renderer.load("models:/rfpp-debug/1")
