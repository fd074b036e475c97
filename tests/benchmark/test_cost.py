"""The cost benchmark measures both networks as they train and render, counts operations, and keeps finished rows."""

import csv
from itertools import pairwise

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from marks import requires_gpu
from networks import SMALLEST, model_config
from omegaconf import OmegaConf

from launch.benchmark import main
from rfpp.benchmark.case import Case
from rfpp.benchmark.cost import QUANTITIES, Untrained, _flops, measure
from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError
from rfpp.training.plan import ACCELERATIONS

CASE = Case(triangles=60, objects=5, views=2, resolution=16, scenes=1)
NETWORKS = {
    "renderformer": Untrained("RenderFormer", model_config("model=renderformer")),
    "rfpp": Untrained("RenderFormer++", model_config()),
}
SMALL = [f"benchmark.case.{name}={value}" for name, value in vars(CASE).items()]
ALL = "benchmark.groups=[{quantities: [training_step, encode, view]}]"


def config(*overrides, benchmark="cost"):
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        return compose("benchmark", overrides=[f"benchmark={benchmark}", "size=tiny", *overrides])


def measured(*overrides, benchmark="cost"):
    ready = instantiate(config(*overrides, benchmark=benchmark).benchmark, _convert_="all")
    return list(ready(progress=lambda done, total: None))


def test_every_quantity_of_both_networks_has_a_row_that_is_not_measured_again(tmp_path):
    path = tmp_path / "cost.csv"
    cfg = config(*SMALLEST, *SMALL, ALL, "benchmark.seconds=0.01", f"output={path}")
    main.__wrapped__(cfg)
    written = path.read_text()
    rows = list(csv.DictReader(written.splitlines()))
    assert [(row["network"], row["quantity"]) for row in rows] == [
        (network.name, quantity) for network in NETWORKS.values() for quantity in QUANTITIES
    ]
    for row in rows:
        assert {name: int(row[name]) for name in vars(CASE)} == vars(CASE)
        assert (row["status"], row["acceleration"], row["device"], row["size"]) == ("ok", "none", "cpu", "tiny")
        assert 0 < float(row["seconds_min"]) <= float(row["seconds"]) and int(row["rounds"]) >= 5
        assert float(row["TFLOP"]) > 0
    assert len({row["parameters"] for row in rows}) == 2
    main.__wrapped__(cfg)
    assert path.read_text() == written


def test_a_long_round_is_not_repeated():
    parts = instantiate(config(*SMALLEST).benchmark.training, _convert_="all")
    group = {"quantities": ["encode"]}
    rows = list(measure(NETWORKS, "tiny", parts, CASE, [group], "cpu", 0, 0, None, lambda *_: None))
    assert [row["rounds"] for row in rows] == [1, 1]


def test_networks_and_training_are_those_of_the_experiments():
    benchmark = OmegaConf.to_container(config(), resolve=True)["benchmark"]
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        train = compose("train", overrides=["run_dir=unused", "experiment=large_scale"])
    assert benchmark["training"]["optimizer"] == OmegaConf.to_container(train.optimizer)
    assert benchmark["training"]["loss"] == {**OmegaConf.to_container(train.loss), "lpips_weight": 0}
    assert benchmark["training"]["gradient_clip"] == train.trainer.gradient_clip_val
    case = benchmark["case"]
    assert (case["triangles"], case["objects"], case["resolution"], case["views"]) == (25_600, 50, 256, 1)


@pytest.mark.parametrize("benchmark", ["cost", "gpu"])
def test_every_group_is_a_case(benchmark):
    settings = OmegaConf.to_container(config(benchmark=benchmark).benchmark, resolve=False)
    for group in settings["groups"]:
        assert group.pop("acceleration", "graphs") in ACCELERATIONS
        assert set(group.pop("quantities")) <= set(QUANTITIES)
        Case(**{**{k: v for k, v in settings["case"].items() if k != "_target_"}, **group})


@pytest.mark.parametrize(
    ("group", "message"),
    [
        ("{quantities: [juggle]}", "unknown quantity 'juggle'"),
        ("{quantities: [view], pixels: 12}", "unknown field 'pixels'"),
        ("{quantities: [view], resolution: 12}", "resolution 12 does not divide into RenderFormer's patches of 8"),
    ],
)
def test_impossible_groups_are_reported(group, message):
    with pytest.raises(UserError, match=message):
        measured(*SMALLEST, *SMALL, f"benchmark.groups=[{group}]")


def test_another_table_is_not_resumed(tmp_path, capsys):
    output = tmp_path / "cost.csv"
    output.write_text("a,b\n1,2\n")
    with pytest.raises(SystemExit):
        main.__wrapped__(config(*SMALL, ALL, f"output={output}"))
    assert "not a table of benchmark=cost" in capsys.readouterr().err


def test_without_a_gpu_it_is_one_line(monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(UserError, match="PyTorch finds no GPU: choose benchmark=cost, which measures on a CPU"):
        measured(benchmark="gpu")


@requires_gpu
def test_rows_of_a_gpu_have_kernels():
    groups = "benchmark.groups=[{quantities: [training_step, view], triangles: 200, objects: 5, resolution: 32}]"
    rows = measured(groups, "benchmark.seconds=0.01", benchmark="gpu")
    found = [(row["network"], row["quantity"], row["status"]) for row in rows]
    assert found == [(n, q, "ok") for n in ("RenderFormer", "RenderFormer++") for q in ("training_step", "view")]
    assert all(row["kernels"] > 100 and row["seconds"] > 0 for row in rows)


class TestOperations:
    """Counted from shapes."""

    @staticmethod
    def count(network: str, quantity: str, **case) -> float:
        shapes, sizes = NETWORKS[network]("meta"), Case(**{**vars(CASE), "views": 1, **case})
        return _flops(shapes, sizes.batch(shapes.gbuffer_channels, seed=0).to("meta"), quantity)

    def test_renderformer_is_quadratic_in_triangles_and_renderformer_pp_linear(self):
        sizes = [(10_000, 20), (20_000, 40), (40_000, 80)]  # more objects of the same size
        for network, low, high in (("renderformer", 3.5, 4.0), ("rfpp", 1.8, 2.2)):
            counts = [self.count(network, "encode", triangles=t, objects=o) for t, o in sizes]
            for count, twice in pairwise(counts):
                assert low < twice / count < high

    def test_a_scene_is_encoded_once_for_all_views(self):
        assert self.count("rfpp", "encode") == self.count("rfpp", "encode", views=4)
        assert 3 < self.count("rfpp", "view", views=4) / self.count("rfpp", "view") <= 4  # keys are those of the scene
