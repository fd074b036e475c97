"""The cost benchmark: who is compared, what is counted, and rows also of what takes too much."""

import csv
from contextlib import suppress
from itertools import pairwise

import pytest
from greedy_tasks import MODERATE, Hungry, Sleepy
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from networks import SMALLEST, model_config
from omegaconf import OmegaConf

from launch.benchmark import main
from rfpp.benchmark.cost.case import Case
from rfpp.benchmark.cost.measuring import measure
from rfpp.benchmark.cost.plot import main as plot
from rfpp.benchmark.cost.process import Limits
from rfpp.benchmark.cost.tasks import Inference, Setting, Untrained
from rfpp.benchmark.cost.turns import Rounds
from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError
from rfpp.evaluation.measuring.csv_files import write_rows

CASE = Case(triangles=60, objects=5, views=2, resolution=16, scenes=1)
SETTING = Setting(device="cpu", precision="bf16-mixed", threads=1, compile=False, seed=0)
NETWORKS = {
    "renderformer": Untrained("RenderFormer", model_config("experiment=renderformer")),
    "rfpp": Untrained("RenderFormer++", model_config()),
}
STEPS = ["training_step", "checkpointed_training_step", "least_memory_training_step"]
TASKS = {"inference": ["encode", "view", "render"], "steps": STEPS}
QUANTITIES = [*TASKS["inference"], *TASKS["steps"]]


def config(*overrides):
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        return compose("benchmark", overrides=["benchmark=cost", "size=tiny", *SMALLEST, *overrides])


def measured(task=None, only=None, rounds=0, **limits):
    """Rows of one task in one small case."""
    made = []
    rows = list(measure(
        NETWORKS, {"task": task or Inference()}, CASE, {"small": [{}]}, only, SETTING, Rounds(rounds, 60),
        Limits(**{"seconds": 300, "memory_gb": None, **limits}), None, lambda *n: made.append(n),
    ))  # fmt: skip
    assert made[-1] == (2 * (1 + rounds), 2 * (1 + rounds))
    return rows


def impossible(changes):
    next(measure(NETWORKS, {}, CASE, {"odd": [changes]}, None, SETTING, Rounds(0, 0), Limits(1, 1), None, print))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The CSV file of a run of the command."""
    path = tmp_path_factory.mktemp("cost") / "cost.csv"
    small = [f"benchmark.case.{name}={value}" for name, value in vars(CASE).items()]
    cfg = config(
        *small, "benchmark.only=[paper,triangles]", "benchmark.sweeps.triangles=[{triangles: 60}]",
        "benchmark.rounds.count=2", "benchmark.setting.threads=1", "benchmark.setting.device=cpu", f"output={path}",
    )  # fmt: skip
    main.__wrapped__(cfg)
    return path


def test_every_quantity_of_both_networks_has_a_complete_row(written):
    rows = list(csv.DictReader(written.open()))
    expected = [(s, q, n.name) for s in ("paper", "triangles") for q in QUANTITIES for n in NETWORKS.values()]
    assert [(row["sweep"], row["quantity"], row["network"]) for row in rows] == expected
    for row in rows:
        whole = row["quantity"] not in ("encode", "view")
        empty = {name for name, value in row.items() if value == ""}
        assert empty == (set() if whole else {"peak_GB", "held_GB", "memory_saved"})
        assert row["status"] == "ok"
        assert row["rounds"] == "2"
        assert {name: int(row[name]) for name in vars(CASE)} == vars(CASE)
        assert (row["device"], row["precision"], row["threads"]) == ("cpu", "bf16-mixed", "1")
        assert row["commit"] and row["hardware"] and row["torch"]
        assert 0 < float(row["seconds_min"]) <= float(row["seconds"])
        rate = float(row["TFLOP"]) / float(row["seconds"])
        assert float(row["TFLOP_per_s"]) == pytest.approx(rate, rel=1e-4)
        assert float(row["of_matrix_rate"]) == pytest.approx(rate / float(row["matrix_TFLOP_per_s"]), rel=1e-4)
        if whole:
            assert 0 < float(row["held_GB"]) <= float(row["peak_GB"])


def test_networks_are_compared_with_the_first_in_the_same_run(written):
    rows = list(csv.DictReader(written.open()))
    for baseline, ours in zip(rows[::2], rows[1::2], strict=True):
        assert float(baseline["speedup"]) == 1
        assert float(ours["speedup"]) == pytest.approx(float(baseline["seconds"]) / float(ours["seconds"]), rel=1e-4)
        if ours["peak_GB"]:
            saved = 1 - float(ours["peak_GB"]) / float(baseline["peak_GB"])
            assert float(ours["memory_saved"]) == pytest.approx(saved, abs=1e-4)


def test_a_case_in_two_sweeps_is_measured_once(written):
    rows = list(csv.DictReader(written.open()))
    paper, again = rows[: len(rows) // 2], rows[len(rows) // 2 :]
    assert [{**row, "sweep": ""} for row in paper] == [{**row, "sweep": ""} for row in again]


def test_a_run_goes_on_where_another_was_interrupted(tmp_path):
    path = tmp_path / "cost.csv"
    sweeps = {"small": [{}, {"triangles": 70}], "other": [{"triangles": 70}, {"triangles": 80}]}
    turns = []

    def interrupted(taken, total):
        turns.append((taken, total))
        if taken == 3:  # in the second case
            raise KeyboardInterrupt

    def run(progress):
        rows = []
        with suppress(KeyboardInterrupt):
            for row in measure(
                NETWORKS, {"task": Inference()}, CASE, sweeps, None, SETTING, Rounds(0, 60), Limits(300, None),
                str(path), progress,
            ):  # fmt: skip
                rows.append(row)
        write_rows(path, rows)
        return path.read_text().splitlines()

    first = run(interrupted)
    assert turns[-1] == (3, 6) and len(first) == 1 + 6  # of the first case
    second = run(lambda *n: turns.append(n))
    assert turns[-1] == (4, 4)  # two cases
    assert second[:7] == first
    assert [line.split(",")[:2] for line in second[1::6]] == [
        ["small", "60"], ["small", "70"], ["other", "70"], ["other", "80"]
    ]  # fmt: skip


def test_rendering_is_encoding_and_the_views(written):
    seconds = {(r["network"], r["quantity"]): float(r["seconds_min"]) for r in csv.DictReader(written.open())}
    for network in NETWORKS.values():
        parts = [seconds[network.name, quantity] for quantity in TASKS["inference"]]
        assert parts[2] >= 0.99 * (parts[0] + CASE.views * parts[1])


def test_the_plot_is_made_of_the_table(written):
    assert plot([str(written)]) == written.with_suffix(".png")
    assert written.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def test_networks_and_training_are_those_of_the_experiments():
    cfg = config()
    benchmark = OmegaConf.to_container(cfg, resolve=True)["benchmark"]
    assert benchmark["networks"]["renderformer"]["model"] == NETWORKS["renderformer"].model
    assert benchmark["networks"]["rfpp"]["model"] == NETWORKS["rfpp"].model
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        train = compose("train", overrides=["run_dir=unused", "experiment=large_scale"])
    for name in TASKS["steps"]:
        assert benchmark["tasks"][name]["optimizer"] == OmegaConf.to_container(train.optimizer)
        assert benchmark["tasks"][name]["loss"] == {**OmegaConf.to_container(train.loss), "lpips_weight": 0}
        assert benchmark["tasks"][name]["gradient_clip"] == train.trainer.gradient_clip_val
    assert benchmark["setting"]["precision"] == train.trainer.precision


def test_the_papers_case_is_its_own_sweep_and_part_of_the_others():
    benchmark = instantiate(config("benchmark.networks={}", "benchmark.tasks={}").benchmark, _convert_="all").keywords
    paper = benchmark["case"]
    assert (paper.triangles, paper.objects, paper.resolution, paper.views) == (25_600, 50, 256, 1)
    for name, points in benchmark["sweeps"].items():
        assert any({**vars(paper), **point} == vars(paper) for point in points), name


def test_time_out_is_a_row_and_leaves_the_other_network_alone():
    rows = measured(Sleepy(), rounds=1, seconds=10)
    assert [row["status"] for row in rows] == 3 * ["timed out after 10 s", "ok"]
    for slow, ours in zip(rows[::2], rows[1::2], strict=True):
        assert (slow["seconds"], slow["rounds"], slow["speedup"], ours["speedup"]) == (None, 0, None, None)
        assert slow["TFLOP"] > 0 and ours["seconds"] > 0


def test_running_out_of_memory_is_a_row_and_memory_is_that_of_the_task():
    rows = measured(Hungry(), memory_gb=1.6)
    assert [row["status"] for row in rows] == 3 * ["out of memory", "ok"]
    hungry, ours = rows[-2:]
    assert hungry["peak_GB"] is None and ours["memory_saved"] is None
    assert ours["peak_GB"] - ours["held_GB"] == pytest.approx(MODERATE / 1e9, abs=0.1)


def test_a_limit_below_what_python_needs_fails_before_the_first_turn():
    assert {row["status"] for row in measured(memory_gb=0.01)} == {"out of memory"}


def test_bad_settings_are_answered_in_one_line():
    with pytest.raises(UserError, match="the sweeps are small"):
        measured(only=["large"])
    with pytest.raises(UserError, match="choose from bf16-mixed, 32-true"):
        Setting(device="cpu", precision="half", threads=None, compile=False, seed=0)
    with pytest.raises(UserError, match="resolution 12 does not divide into RenderFormer's patches of 8"):
        impossible({"resolution": 12})
    with pytest.raises(UserError, match="varies pixels"):
        impossible({"pixels": 12})


class TestOperations:
    """Counted, not timed."""

    @staticmethod
    def of(network: str, task=None, **case) -> dict[str, float]:
        at = Case(**{**vars(CASE), **case})
        made = NETWORKS[network]("meta")
        return (task or Inference()).flops(made, at.batch(made.gbuffer_channels, seed=0).to("meta"))

    def test_those_of_renderformers_encoder_are_what_its_layers_say(self):
        width, hidden, layers = 54, 64, 4
        triangles = 1008
        tokens = triangles + 16  # a multiple of what attention pads to
        attention = 4 * tokens**2 * width
        linear = 2 * tokens * (4 * width**2 + 3 * width * hidden)
        embedding = 2 * triangles * width * (10 + 9 * 13)
        counted = self.of("renderformer", triangles=triangles)["encode"]
        assert counted == layers * (attention + linear) + embedding

    def test_renderformers_grow_with_the_square_of_the_triangles_ours_with_their_number(self):
        sizes = [(10_000, 20), (20_000, 40), (40_000, 80)]  # objects of the same size, ever more of them
        for network, low, high in (("renderformer", 3.5, 4.0), ("rfpp", 1.8, 2.2)):
            counts = [self.of(network, triangles=t, objects=o)["encode"] for t, o in sizes]
            for count, twice in pairwise(counts):
                assert low < twice / count < high

    def test_a_scene_is_encoded_once_for_all_its_views(self):
        one, four = self.of("rfpp", views=1), self.of("rfpp", views=4)
        assert one["encode"] == four["encode"] and one["view"] == four["view"]
        assert four["render"] == four["encode"] + 4 * four["view"]

    def test_a_training_step_is_three_forward_passes(self):
        step = instantiate(config("benchmark.networks={}").benchmark.tasks.training_step)
        count = self.of("renderformer", step, views=1)["training_step"]
        assert count == 3 * self.of("renderformer", views=1)["render"]
