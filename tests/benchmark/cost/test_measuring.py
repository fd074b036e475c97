"""The cost benchmark compares two networks in turns, counts operations, and has rows for failures."""

import csv
from contextlib import suppress
from itertools import pairwise

import psutil
import pytest
from greedy_tasks import MODERATE, Hungry, Sleepy
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from networks import SMALLEST, model_config
from omegaconf import OmegaConf

from launch.benchmark import main
from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.measuring import Point, Rounds, measure, points
from rfpp.benchmark.cost.tasks import Inference, Setting, Untrained
from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError
from rfpp.evaluation.measuring.csv_files import write_rows

CASE = Case(triangles=60, objects=5, views=2, resolution=16, scenes=1)
SETTING = Setting(device="cpu", precision="bf16-mixed")
NETWORKS = {
    "renderformer": Untrained("RenderFormer", model_config("model=renderformer")),
    "rfpp": Untrained("RenderFormer++", model_config()),
}
STEPS = ["training_step", "checkpointed_training_step", "least_memory_training_step"]
QUANTITIES = ["encode", "view", "render", *STEPS]
SMALL = [f"benchmark.case.{name}={value}" for name, value in vars(CASE).items()]


def config(*overrides, benchmark="cost"):
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        return compose("benchmark", overrides=[f"benchmark={benchmark}", "size=tiny", *SMALLEST, *overrides])


def rows_of(task, count=0, timeout=300):
    """Return the rows of a task in one small case."""
    turns = []
    rounds = Rounds(count, enough_seconds=60, timeout=timeout)
    rows = list(measure(NETWORKS, {"t": task}, CASE, [{}], SETTING, rounds, None, lambda *turn: turns.append(turn)))
    assert turns == [(n, 2 * (1 + count)) for n in range(2 * (1 + count) + 1)]
    return rows


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Path of the CSV file that the command writes."""
    path = tmp_path_factory.mktemp("cost") / "cost.csv"
    cfg = config(
        *SMALL, "benchmark.groups=[{},{triangles: [60]}]", "benchmark.rounds.count=2", "benchmark.setting.device=cpu",
        f"output={path}",
    )  # fmt: skip
    main.__wrapped__(cfg)
    return path


def test_every_quantity_of_both_networks_has_a_complete_row(written):
    rows = list(csv.DictReader(written.open()))
    # the second group is the same point, which is measured once
    assert [(row["quantity"], row["network"]) for row in rows] == [
        (quantity, network.name) for quantity in QUANTITIES for network in NETWORKS.values()
    ]
    for row in rows:
        whole = row["quantity"] not in ("encode", "view")
        empty = {name for name, value in row.items() if value == ""}
        assert empty == {"of_peak"} | (set() if whole else {"peak_GB", "held_GB", "memory_saved"})
        assert (row["status"], row["rounds"], row["compiled"]) == ("ok", "2", "false")
        assert {name: int(row[name]) for name in vars(CASE)} == vars(CASE)
        assert (row["device"], row["precision"]) == ("cpu", "bf16-mixed")
        assert 0 < float(row["seconds_min"]) <= float(row["seconds"])
        assert float(row["TFLOP_per_s"]) == pytest.approx(float(row["TFLOP"]) / float(row["seconds"]), rel=1e-4)
        if whole:
            assert 0 < float(row["held_GB"]) <= float(row["peak_GB"])
    assert len({row["parameters"] for row in rows}) == 2


def test_networks_are_compared_with_the_first_in_the_same_run(written):
    rows = list(csv.DictReader(written.open()))
    for baseline, ours in zip(rows[::2], rows[1::2], strict=True):
        assert float(baseline["speedup"]) == 1
        assert float(ours["speedup"]) == pytest.approx(float(baseline["seconds"]) / float(ours["seconds"]), rel=1e-4)
        if ours["peak_GB"]:
            saved = 1 - float(ours["peak_GB"]) / float(baseline["peak_GB"])
            assert float(ours["memory_saved"]) == pytest.approx(saved, abs=1e-4)


def test_an_interrupted_run_is_resumed(tmp_path):
    path = tmp_path / "cost.csv"
    groups = [{"triangles": [60, 70]}, {"triangles": [70, 80]}]
    turns = []

    def interrupt(taken, total):
        turns.append((taken, total))
        if taken == 3:  # in the second case
            raise KeyboardInterrupt

    def run(progress):
        rows = []
        with suppress(KeyboardInterrupt):
            for row in measure(
                NETWORKS, {"t": Inference()}, CASE, groups, SETTING, Rounds(0, 60, 300), str(path), progress
            ):  # fmt: skip
                rows.append(row)
        write_rows(path, rows)
        return path.read_text().splitlines()

    first = run(interrupt)
    assert turns[-1] == (3, 6) and len(first) == 1 + 6  # of the first case
    second = run(lambda *turn: turns.append(turn))
    assert turns[-1] == (4, 4)  # two cases
    assert second[:7] == first
    assert [line.split(",")[0] for line in second[1::6]] == ["60", "70", "80"]


def test_groups_are_products_with_each_point_once():
    found = points([{"networks": ["b"], "scenes": [1, 2]}, {"scenes": 1, "task": "x"}], CASE, ["x", "y"], ["a", "b"])
    of_case = {scenes: Case(60, 5, 2, 16, scenes) for scenes in (1, 2)}
    products = [Point(task, ("b",), False, of_case[scenes]) for task in ("x", "y") for scenes in (1, 2)]
    assert found == [*products, Point("x", ("a", "b"), False, of_case[1])]
    assert points([{}, {"scenes": [1]}], CASE, ["x"], ["a"]) == [Point("x", ("a",), False, CASE)]


def test_networks_and_training_are_those_of_the_experiments():
    cfg = config("benchmark.setting.device=cpu")
    benchmark = OmegaConf.to_container(cfg, resolve=True)["benchmark"]
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        train = compose("train", overrides=["run_dir=unused", "experiment=large_scale"])
    for key, network in NETWORKS.items():
        assert benchmark["networks"][key]["name"] == network.name
    for step in STEPS:
        assert benchmark["tasks"][step]["optimizer"] == OmegaConf.to_container(train.optimizer)
        assert benchmark["tasks"][step]["loss"] == {**OmegaConf.to_container(train.loss), "lpips_weight": 0}
        assert benchmark["tasks"][step]["gradient_clip"] == train.trainer.gradient_clip_val
    assert benchmark["setting"]["precision"] == train.trainer.precision
    settings = instantiate(cfg.benchmark, _convert_="all").keywords
    paper = settings["case"]
    assert (paper.triangles, paper.objects, paper.resolution, paper.views) == (25_600, 50, 256, 1)
    wanted = points(settings["groups"], paper, list(settings["tasks"]), list(settings["networks"]))
    assert {(point.task, point.networks) for point in wanted if point.case == paper} >= {
        (task, ("renderformer", "rfpp")) for task in ("inference", *STEPS)
    }


def test_a_timeout_is_a_row_and_does_not_stop_the_other_network():
    rows = rows_of(Sleepy(), count=1, timeout=10)
    assert [row["status"] for row in rows] == 3 * ["timed out after 10 s", "ok"]
    for slow, ours in zip(rows[::2], rows[1::2], strict=True):
        assert (slow["seconds"], slow["rounds"], slow["speedup"], ours["speedup"]) == (None, 0, None, None)
        assert slow["TFLOP"] > 0 and ours["seconds"] > 0


def test_a_process_that_takes_all_memory_is_stopped(monkeypatch):
    memory = psutil.virtual_memory()
    monkeypatch.setattr(psutil, "virtual_memory", lambda: memory._replace(available=1_500_000_000))
    rows = rows_of(Hungry(bytes=3_000_000_000))
    assert [row["status"] for row in rows] == 3 * ["out of memory", "ok"]
    hungry, ours = rows[-2:]
    assert hungry["peak_GB"] is None and ours["memory_saved"] is None
    assert ours["peak_GB"] - ours["held_GB"] == pytest.approx(MODERATE / 1e9, abs=0.1)


def test_invalid_settings_are_reported():
    for group, message in [
        ({"pixels": 12}, "unknown field 'pixels'"),
        ({"task": "juggling"}, "unknown task 'juggling'"),
        ({"networks": ["nerf"]}, "unknown network 'nerf'"),
        ({"resolution": 12}, "resolution 12 does not divide into RenderFormer's patches of 8"),
    ]:
        with pytest.raises(UserError, match=message):
            next(measure(NETWORKS, {"t": Inference()}, CASE, [group], SETTING, Rounds(0, 0, 0), None, print))
    with pytest.raises(UserError, match="choose from bf16-mixed, 32-true"):
        Setting(device="cpu", precision="half")


def test_another_table_is_not_resumed(tmp_path, capsys):
    output = tmp_path / "cost.csv"
    output.write_text("a,b\n1,2\n")
    with pytest.raises(SystemExit):
        main.__wrapped__(config(*SMALL, "benchmark.groups=[{}]", f"output={output}"))
    assert "not a table of benchmark=cost" in capsys.readouterr().err


class TestOperations:
    """Counted from shapes."""

    @staticmethod
    def count(network: str, task=None, **case) -> dict[str, float]:
        batch_size = Case(**{**vars(CASE), **case})
        shapes = NETWORKS[network]("meta")
        return (task or Inference()).flops(shapes, batch_size.batch(shapes.gbuffer_channels, seed=0).to("meta"))

    def test_renderformer_is_quadratic_in_triangles_and_renderformer_pp_linear(self):
        sizes = [(10_000, 20), (20_000, 40), (40_000, 80)]  # more objects of the same size
        for network, low, high in (("renderformer", 3.5, 4.0), ("rfpp", 1.8, 2.2)):
            counts = [self.count(network, triangles=t, objects=o)["encode"] for t, o in sizes]
            for count, twice in pairwise(counts):
                assert low < twice / count < high

    def test_a_scene_is_encoded_once_for_all_views(self):
        one, four = self.count("rfpp", views=1), self.count("rfpp", views=4)
        assert one["encode"] == four["encode"] and one["view"] == four["view"]
        assert four["render"] == four["encode"] + 4 * four["view"]

    def test_a_training_step_is_three_forward_passes(self):
        step = instantiate(config("benchmark.networks={}").benchmark.tasks.training_step)
        count = self.count("renderformer", step, views=1)["training_step"]
        assert count == 3 * self.count("renderformer", views=1)["render"]
