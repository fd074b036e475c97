"""Resumed runs end with the weights of an uninterrupted run, bit by bit, for every way of stopping."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from mlflow import MlflowClient
from small_data import BoxFamily, make
from training_runs import SETTINGS, differing, finish, output, start, train, wait_for_step

from rfpp.commands import CONFIG_DIR
from rfpp.training.callbacks.divergence import WINDOW
from rfpp.training.checkpoint_files import step_file, step_files
from rfpp.training.tracking.journal import JOURNAL, RUN_FILE, records
from rfpp.training.tracking.mlflow_run import store_uri

STEPS = 10
RUN = (f"steps={STEPS}", "trainer.val_check_interval=4", "datamodule.source.validation_scenes=3")
#: Where summing in another order may not be magnified, as Adam does with gradients near zero.
PLAIN_DESCENT = ("optimizer._target_=torch.optim.SGD", "optimizer.lr=0.3", "trainer.precision=32-true")
#: No checkpoint before the last step.
RARELY = ("callbacks.checkpoints.every_n_steps=1000", "callbacks.checkpoints.every_n_minutes=null")
LOGGED = {"train/loss", "validation/log_l1"}
PRECISIONS = {"fp32": ("trainer.precision=32-true",), "bf16": ("trainer.precision=bf16-mixed",)}


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    root, splits = tmp_path_factory.mktemp("data") / "small", {"train": 7, "validation": 3}
    return Path(make(root, BoxFamily(views=1), splits=splits, views=1).root)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def uninterrupted(folder, data):
    """The run folder of each precision; three checkpoints are in it."""
    for name, settings in PRECISIONS.items():
        train(folder / name, data, *RUN, *settings)
    return {name: folder / name for name in PRECISIONS}


@pytest.fixture(scope="module")
def two_ranks(folder, data):
    return train(folder / "two-ranks", data, *RUN, *PLAIN_DESCENT, ranks=2)


def last(run_dir: Path) -> dict:
    return torch.load(run_dir / "checkpoints" / "last.ckpt", weights_only=True)


def logged(run_dir: Path) -> list[tuple[int, str, float]]:
    """Losses and validation scores in the journal."""
    metrics = [record for record, _ in records(run_dir / JOURNAL) if record["kind"] == "metrics"]
    values = [(r["step"], name, r["values"][name]) for r in metrics for name in LOGGED & r["values"].keys()]
    return sorted(values)


def weights(checkpoint: dict) -> torch.Tensor:
    return torch.cat([w.flatten() for name, w in sorted(checkpoint["state_dict"].items())])


def best_score(checkpoint: dict) -> float:
    [score] = [s["best_model_score"] for s in checkpoint["callbacks"].values() if "best_model_score" in s]
    return float(score)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_killed_at_random_moments_it_ends_with_the_same_bits(precision, uninterrupted, data, folder):
    run_dir, rng = folder / f"killed-{precision}", np.random.default_rng(len(precision))
    for step in (1, 4):  # step 4 is followed by a validation
        (process,) = start(run_dir, data, *RUN, *PRECISIONS[precision])
        wait_for_step(run_dir, step)
        time.sleep(rng.uniform(0, 0.2))
        os.kill(process.pid, signal.SIGKILL)
        assert finish([process]) in ([-signal.SIGKILL], [0]), output(run_dir)
    ended = train(run_dir, data, *RUN, *PRECISIONS[precision])
    whole = last(uninterrupted[precision])
    assert ended["global_step"] == STEPS
    assert differing(ended, whole) == [], output(run_dir)
    assert best_score(ended) == best_score(whole)
    assert logged(run_dir) == logged(uninterrupted[precision])
    assert [step for step, name, _ in logged(run_dir) if name == "train/loss"] == list(range(STEPS))
    assert not list((run_dir / "checkpoints").glob(".*"))


def test_a_truncated_newest_checkpoint_is_skipped(uninterrupted, data, folder):
    """The one before was saved after a validation, which is not repeated."""
    run_dir = folder / "truncated"
    shutil.copytree(uninterrupted["bf16"] / "checkpoints", run_dir / "checkpoints", symlinks=True)
    newest, before = (step_file(run_dir / "checkpoints", step) for step in (STEPS, STEPS - 2))
    step_file(run_dir / "checkpoints", STEPS - 1).unlink()
    newest.write_bytes(newest.read_bytes()[:-1000])
    ended = train(run_dir, data, *RUN, *PRECISIONS["bf16"])
    assert f"warning: {newest}: truncated" in output(run_dir)
    assert f"Resumes  {before}" in output(run_dir)
    assert differing(ended, last(uninterrupted["bf16"])) == []
    assert logged(run_dir) == [x for x in logged(uninterrupted["bf16"]) if x[0] >= STEPS - 2]


@pytest.mark.parametrize("how", ["accumulated", "two ranks", "one rank, then two"])
def test_one_global_batch_is_one_step_however_it_is_divided(how, folder, data, two_ranks, request):
    alone = request.getfixturevalue("alone")
    if how == "two ranks":
        other, run_dir = two_ranks, folder / "two-ranks"  # which share three validation scenes
        assert best_score(other) == pytest.approx(best_score(last(alone)), rel=1e-4)
    elif how == "accumulated":
        run_dir = folder / "parts"
        other = train(run_dir, data, *RUN, *PLAIN_DESCENT, "datamodule.batching.scenes_per_device=2")
    else:
        run_dir = folder / "joined"
        shutil.copytree(alone / "checkpoints", run_dir / "checkpoints", symlinks=True)
        step_file(run_dir / "checkpoints", STEPS).unlink()
        step_file(run_dir / "checkpoints", STEPS - 1).unlink()
        other = train(run_dir, data, *RUN, *PLAIN_DESCENT, "datamodule.batching.scenes_per_device=1", ranks=2)
        assert len(other["random_states"]) == 2
    assert other["global_step"] == STEPS
    if how != "one rank, then two":
        losses, same = ([loss for _, name, loss in logged(run) if name == "train/loss"] for run in (alone, run_dir))
        assert same == pytest.approx(losses, rel=1e-3)
    first = torch.load(step_file(alone / "checkpoints", STEPS - 2), weights_only=True)
    moved = (weights(last(alone)) - weights(first)).abs().max()
    assert (weights(other) - weights(last(alone))).abs().max() < 1e-3 * moved


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_streamed_run_without_buffer_ends_with_the_same_bits(ranks, folder, data):
    streamed = (*RUN, "datamodule.reader=webdataset", "datamodule.reader.buffer=1")
    whole = train(folder / f"streamed-{ranks}", data, *streamed, ranks=ranks)
    run_dir = folder / f"streamed-again-{ranks}"
    shutil.copytree(folder / f"streamed-{ranks}" / "checkpoints", run_dir / "checkpoints", symlinks=True)
    for step in (STEPS, STEPS - 1):
        step_file(run_dir / "checkpoints", step).unlink()
    ended = train(run_dir, data, *streamed, ranks=ranks)
    assert "Resumes" in output(run_dir)
    assert differing(ended, whole) == []


def test_a_resumed_run_takes_the_settings_of_its_command(folder, data, alone):
    run_dir = folder / "slower"
    for part in ("checkpoints", "tracking"):
        shutil.copytree(alone / part, run_dir / part, symlinks=True)
    step_file(run_dir / "checkpoints", STEPS).unlink()
    before = torch.load(step_file(run_dir / "checkpoints", STEPS - 1), weights_only=True)
    ended = train(run_dir, data, *RUN, *PLAIN_DESCENT, "optimizer.lr=0.003", "optimizer.weight_decay=0.002")
    groups = ended["optimizer_states"][0]["param_groups"]
    assert [(group["initial_lr"], group["weight_decay"]) for group in groups] == [(0.003, 0.002), (0.003, 0.0)]
    steps = [(weights(after) - weights(before)).norm() for after in (ended, last(alone))]
    assert steps[0] < 0.05 * steps[1]
    tags = [record["values"] for record, _ in records(run_dir / JOURNAL) if record["kind"] == "tags"][-1]
    assert (tags["resumed/optimizer.lr"], tags["resumed/optimizer.weight_decay"]) == ("0.003", "0.002")
    other = ("optimizer._target_=torch.optim.AdamW", "optimizer.lr=0.003", "steps=12")
    assert finish(start(run_dir, data, *RUN, *PLAIN_DESCENT, *other)) == [1]
    assert "error: the run to resume had another optimizer" in output(run_dir)


@pytest.fixture(scope="module")
def alone(folder, data):
    train(folder / "alone", data, *RUN, *PLAIN_DESCENT)
    return folder / "alone"


def test_going_back_is_a_branch_that_keeps_what_it_left(folder, data, alone):
    run_dir = folder / "branches"
    for part in ("checkpoints", "tracking"):
        shutil.copytree(alone / part, run_dir / part, symlinks=True)
    left, run = last(alone), json.loads((alone / RUN_FILE).read_bytes())["run_id"]
    choice = f"checkpoint={step_file(run_dir / 'checkpoints', STEPS - 2)}"
    train(run_dir, data, *RUN, *PLAIN_DESCENT, choice, "optimizer.lr=0.003")
    assert f"Branch   what came after is in {run_dir}/rolled_back/1" in output(run_dir)
    aside = run_dir / "rolled_back" / "1"
    assert differing(torch.load(step_file(aside / "checkpoints", STEPS), weights_only=True), left) == []
    assert logged(aside) == logged(alone)
    rows = {run: {row[:2]: row[2] for row in logged(run)} for run in (run_dir, alone)}
    assert rows[run_dir].keys() == rows[alone].keys()
    changed = {key for key, value in rows[alone].items() if value != rows[run_dir][key]}
    assert changed == {(STEPS - 1, "train/loss")}  # after a step with another learning rate
    client = MlflowClient(store_uri(folder))
    new = client.get_run(json.loads((run_dir / RUN_FILE).read_bytes())["run_id"])
    assert (new.data.tags["branch/step"], new.data.tags["branch/left_run"]) == (str(STEPS - 2), run)
    assert new.data.params["optimizer.lr"] == "0.003"
    assert len(client.get_metric_history(new.info.run_id, "train/loss")) == STEPS
    again = train(run_dir, data, *RUN, *PLAIN_DESCENT, choice)
    assert differing(again, left) == []
    assert logged(run_dir) == logged(alone)


def test_a_run_that_diverges_goes_back_and_leaves_out_where_it_began(folder, data):
    run_dir, keep = folder / "diverged", "callbacks.checkpoints.keep=30"
    # so that an ordinary loss counts as too high as soon as there is a median
    alarm = ("callbacks.divergence.factor=0.001", "callbacks.divergence.patience=3")
    lasting = (*RUN, *PLAIN_DESCENT, "steps=24", "optimizer.weight_decay=0", keep, *alarm)
    assert finish(start(run_dir, data, *lasting)) == [1]
    assert "error: step 23: training has diverged" in output(run_dir)
    shutil.rmtree(run_dir)
    assert finish(start(run_dir, data, *lasting, "roll_backs=1")) == [128 + signal.SIGUSR1]
    before = step_file(run_dir / "checkpoints", WINDOW - 1)
    omitted = f"omits steps {WINDOW}–{WINDOW + 1}, where training began to"
    assert f"goes back to {before} and {omitted}" in output(run_dir)
    train(run_dir, data, *lasting, "roll_backs=1")
    after = [step_file(run_dir / "checkpoints", WINDOW + n) for n in range(-1, 3)]
    at = [weights(torch.load(path, weights_only=True)) for path in after]
    assert [bool((a == b).all()) for a, b in pairwise(at)] == [True, True, False]
    left = step_file(run_dir / "rolled_back" / "1" / "checkpoints", WINDOW + 1)
    assert (weights(torch.load(left, weights_only=True)) != at[2]).any()


def test_ranks_stop_together_when_one_is_told_to_and_say_how_to_go_on(folder, data, two_ranks):
    run_dir = folder / "stopped"
    processes = start(run_dir, data, *RUN, *PLAIN_DESCENT, ranks=2)
    wait_for_step(run_dir, 2)
    os.kill(processes[1].pid, signal.SIGTERM)
    assert finish(processes) == [128 + signal.SIGTERM, 0], output(run_dir)
    stopped_at = last(run_dir)["global_step"]
    assert 2 <= stopped_at < STEPS
    said = f"stopped by SIGTERM after step {stopped_at} of {STEPS}: resume with the same command and run_dir={run_dir}"
    assert said in output(run_dir)
    ended = train(run_dir, data, *RUN, *PLAIN_DESCENT, ranks=2)
    assert differing(ended, two_ranks) == []


def test_ranks_that_would_resume_from_different_steps_are_refused(folder, data, two_ranks):
    run_dir = folder / "blind"
    shutil.copytree(folder / "two-ranks" / "checkpoints", run_dir / "checkpoints", symlinks=True)
    for rank in range(2):
        (run_dir / f"rank-{rank}.ckpt").symlink_to(step_file(run_dir / "checkpoints", STEPS - 1 - rank))
    choice = f"checkpoint={run_dir}/rank-${{oc.env:LOCAL_RANK}}.ckpt"
    assert finish(start(run_dir, data, *RUN, *PLAIN_DESCENT, choice, ranks=2)) == [1, 1]
    assert f"error: ranks found checkpoints of different steps ([{STEPS - 1}, {STEPS - 2}])" in output(run_dir)


def test_torchrun_trains_with_the_same_bits(folder, data, two_ranks):
    run_dir = folder / "torchrun"
    command = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node=2", "launch/train.py", *SETTINGS, *RUN,
               *PLAIN_DESCENT, f"data.root={data}", f"run_dir={run_dir}", "logger=none", "trainer.devices=2",
               "trainer.strategy=ddp"]  # fmt: skip
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    ended = subprocess.run(command, cwd=CONFIG_DIR.parent, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert differing(last(run_dir), two_ranks) == []


def test_control_c_saves_and_the_same_command_goes_on(folder, data, uninterrupted):
    run_dir = folder / "control-c"
    (process,) = start(run_dir, data, *RUN, *PRECISIONS["bf16"])
    wait_for_step(run_dir, 2)
    os.kill(process.pid, signal.SIGINT)
    assert finish([process]) == [128 + signal.SIGINT], output(run_dir)
    stopped_at = last(run_dir)["global_step"]
    assert 2 <= stopped_at < STEPS
    said = f"stopped by SIGINT after step {stopped_at} of {STEPS}: resume with the same command and run_dir={run_dir}"
    assert said in output(run_dir)
    assert differing(train(run_dir, data, *RUN, *PRECISIONS["bf16"]), last(uninterrupted["bf16"])) == []


def test_the_steps_before_an_error_are_not_lost(folder, data, uninterrupted):
    run_dir, failing = folder / "failing", "+callbacks.failing._target_=faulty_callbacks.Failing"
    assert finish(start(run_dir, data, *RUN, *PRECISIONS["fp32"], *RARELY, failing)) == [1]
    assert "a failure of the sixth step" in output(run_dir)
    assert last(run_dir)["global_step"] == 5
    ended = train(run_dir, data, *RUN, *PRECISIONS["fp32"], *RARELY)
    assert "Resumes" in output(run_dir)
    assert differing(ended, last(uninterrupted["fp32"])) == []


def test_ranks_agree_on_checkpoints_by_time(folder, data):
    """The first rank's clock decides for the second, too, which else would wait for it in a save, or it for that."""
    run_dir = folder / "by-time"
    by_time = (*RARELY, "callbacks.checkpoints.every_n_minutes=1e-6")
    by_time += ("callbacks.checkpoints.keep=100", "steps=40")
    train(
        run_dir, data, *RUN, *PLAIN_DESCENT, *by_time, "+callbacks.skewed._target_=faulty_callbacks.LateClock", ranks=2
    )
    saved = len(step_files(run_dir / "checkpoints"))
    assert 2 <= saved < 40  # as each takes longer than a twentieth of the steps before the next


def test_a_loss_that_is_not_finite_stops_training_and_names_its_scenes(folder, data):
    run_dir = folder / "exploding"
    exploding = ("optimizer.lr=1e14", "schedule.warmup_steps=1", "datamodule.batching.scenes_per_device=2", *RARELY)
    assert finish(start(run_dir, data, *RUN, *PLAIN_DESCENT, *exploding)) == [1]
    errors = [line for line in output(run_dir).splitlines() if line.startswith("error: ")]
    (path,) = (run_dir / "non_finite").iterdir()
    step = int(path.name.split("-")[1])
    assert len(errors) == 1 and f"step {step}: the loss or its gradient is not finite" in errors[0]
    batches = json.loads(path.read_text())
    assert [len(batch["scenes"]) for batch in batches] == [2, 2]
    assert not np.isfinite([float(batch["loss"]) for batch in batches]).all()
    assert max(step_files(run_dir / "checkpoints")) == step_file(run_dir / "checkpoints", step - 1)
