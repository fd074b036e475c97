"""The table of a GPU machine, made on the CPU: rows of everything asked for, in parts, and what it refuses."""

import csv

import pytest
import torch
from hydra import compose, initialize_config_dir

from launch.benchmark import main
from rfpp.benchmark.gpu import measurements
from rfpp.commands import CONFIG_DIR
from rfpp.training.flops import published_peak

SMALL = (
    "benchmark.setting.device=cpu", "benchmark.setting.threads=1", "benchmark.repeats.warm_up=1",
    "benchmark.repeats.least=2", "benchmark.repeats.most=2",
    "benchmark.case={size: tiny, compiled: false, triangles: 60, objects: 5, views: 1, resolution: 16, scenes: 1}",
)  # fmt: skip
LOADING = (
    "family@benchmark.loading.data.family=quickstart", "benchmark.loading.data.scenes=2",
    "benchmark.loading.data.data.scenes_per_shard=1", "benchmark.loading.data.data.resolution=16",
    "benchmark.loading.data.farm.workers=1", "benchmark.loading.datamodule.workers=1", "benchmark.loading.batches=2",
    "benchmark.loading.rounds=1", "benchmark.loading.size=tiny", "benchmark.loading.compiled=false",
)  # fmt: skip
GROUPS = (
    "benchmark.groups=[{task: training_step, network: [rfpp, renderformer]}, {task: inference, network: known_light}]"
)


def config(output, *overrides, loading=("benchmark.loading=null",)):
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        return compose("benchmark", overrides=["benchmark=gpu", f"output={output}", *SMALL, *loading, *overrides])


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    output = tmp_path_factory.mktemp("gpu") / "gpu.csv"
    main.__wrapped__(config(output, GROUPS, loading=LOADING))
    return output, list(csv.DictReader(output.open()))


def test_every_measurement_has_its_rows(rows):
    *measured, _ = rows[1]
    found = {(row["task"], row["network"], row["quantity"]) for row in measured}
    assert found == {
        ("training_step", "rfpp", "training_step"),
        ("training_step", "renderformer", "training_step"),
        *(("inference", "known_light", quantity) for quantity in ("encode", "view", "render")),
    }
    for row in measured:
        assert row["status"] == "ok" and float(row["seconds"]) > 0 and float(row["TFLOP"]) > 0
        assert int(row["runs"]) == 2
        per_second = float(row["TFLOP"]) / float(row["seconds"])
        assert float(row["TFLOP_per_s"]) == pytest.approx(per_second, rel=1e-3)
        assert float(row["of_matrix_rate"]) == pytest.approx(per_second / float(row["matrix_TFLOP_per_s"]), rel=1e-3)
        tokens = {"renderformer": 16 + 60 + 2 * 2}.get(row["network"], 5 * 8 + 4 * 4)
        assert float(row["tokens_per_s"]) * float(row["seconds"]) == pytest.approx(tokens, rel=1e-3)


def test_the_loader_stands_beside_the_step_it_feeds(rows):
    *others, row = rows[1]
    assert row["task"] == row["quantity"] == "loading" and row["status"] == "ok"
    assert (row["scenes"], row["views"], row["resolution"], row["workers"]) == ("2", "2", "16", "1")
    assert int(row["triangles"]) > 100 and int(row["objects"]) > 2
    loaded, consumed = float(row["images_per_s"]), float(row["step_images_per_s"])
    assert loaded == pytest.approx(2 * float(row["scenes_per_s"]), rel=1e-3)
    assert loaded == pytest.approx(4 / float(row["seconds"]), rel=1e-3)
    assert consumed == pytest.approx(4 / float(row["step_seconds"]), rel=1e-3)
    assert float(row["of_step"]) == pytest.approx(loaded / consumed, rel=1e-3)
    assert {other["images_per_s"] for other in others} == {""}


def test_the_same_command_goes_on_and_measures_nothing_twice(rows, tmp_path):
    output = tmp_path / "gpu.csv"
    output.write_bytes(rows[0].read_bytes())
    again = main.__wrapped__(config(output, GROUPS, loading=LOADING))
    assert [row["seconds"] for row in again] == [row["seconds"] for row in rows[1]]
    more = ("benchmark.minutes=0", "benchmark.case.scenes=2", "benchmark.loading.size=small")
    further = main.__wrapped__(config(output, GROUPS, *more, loading=LOADING))
    assert len(further) == len(again), "nothing is begun when the time is up"


def test_memory_that_is_not_there_is_a_row(tmp_path, monkeypatch):
    def greedy(*_):
        raise torch.OutOfMemoryError

    monkeypatch.setattr("rfpp.benchmark.cost.tasks.TrainingStep.prepared", greedy)
    output = tmp_path / "gpu.csv"
    main.__wrapped__(config(output, "benchmark.groups=[{task: training_step, network: rfpp}]", loading=LOADING))
    row, loading = csv.DictReader(output.open())
    assert row["status"] == "out of memory" and row["seconds"] == "" and float(row["TFLOP"]) > 0
    assert loading["status"] == "out of memory" and float(loading["images_per_s"]) > 0 and loading["of_step"] == ""


def test_groups_are_combinations_each_once():
    case = {"size": "tiny", "compiled": False, "triangles": 9, "objects": 3, "views": 1, "resolution": 16, "scenes": 1}
    found = measurements([{"task": "a", "network": ["x", "y"], "scenes": [1, 2]}, {"task": "a", "network": "x"}], case)
    assert [(m.network, m.scenes) for m in found] == [("x", 1), ("x", 2), ("y", 1), ("y", 2)]


@pytest.mark.parametrize(
    ("group", "message"),
    [
        ("{task: training_step, network: rfpp, colour: 3}", "colour: choose from"),
        ("{task: juggling, network: rfpp}", "task juggling: there are training_step"),
        ("{task: training_step, network: nerf}", "network nerf"),
    ],
)
def test_what_is_not_there_is_named(group, message, tmp_path, capsys):
    with pytest.raises(SystemExit):
        main.__wrapped__(config(tmp_path / "gpu.csv", f"benchmark.groups=[{group}]"))
    assert message in capsys.readouterr().err


def test_another_table_is_not_gone_on_with(tmp_path, capsys):
    output = tmp_path / "gpu.csv"
    output.write_text("a,b\n1,2\n")
    with pytest.raises(SystemExit):
        main.__wrapped__(config(output, GROUPS))
    assert "benchmark=gpu" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("card", "peak"), [("NVIDIA H100 80GB HBM3", 989e12), ("NVIDIA H100 PCIe", 756e12), ("Nobody's card", None)]
)
def test_a_card_s_published_peak(card, peak, monkeypatch):
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda _: card)
    assert published_peak(torch.device("cuda"), torch.bfloat16) == peak
    assert published_peak(torch.device("cuda"), torch.float32) is None
