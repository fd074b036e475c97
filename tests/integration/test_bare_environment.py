"""The core install without extras: training from shards, rendering, command lines of benchmarks."""

import csv
import json
import re
import tomllib

import bare_environment
import pytest
from bare_environment import ROOT, closure, hidden, requirements_with
from networks import SMALLEST
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from small_data import make

from rfpp.extras import EXTRAS

STEPS = 3


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """`bare(*arguments, extras=())`: what Python prints there."""
    folder = tmp_path_factory.mktemp("bare")

    def run(*arguments: str, code: int = 0, extras: tuple[str, ...] = ()) -> str:
        done = bare_environment.python(folder, *arguments, extras=extras)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout + done.stderr

    return run


@pytest.fixture(scope="module")
def trained(tmp_path_factory, bare):
    """The run's folder and what was said."""
    folder = tmp_path_factory.mktemp("trained")
    data = make(folder / "data", splits={"train": 3, "validation": 2, "test": 3}).root
    said = bare(
        "launch/train.py", "experiment=quickstart", "debug=cpu", "logger=none", *SMALLEST, f"data.root={data}",
        "data.resolution=8", f"steps={STEPS}", "trainer.val_check_interval=2", "loss.lpips_weight=0.0",
        f"run_dir={folder}/run", "callbacks.panels.scenes=1", "schedule.warmup_steps=1",
    )  # fmt: skip
    return folder / "run", said


def test_it_is_bare():
    modules, distributions = hidden(closure(requirements_with()))
    assert {*EXTRAS} - {"viser", "mitsuba"} <= set(modules)  # these may not be there at all
    assert {"torch", "lightning", "omegaconf", "yaml", "PIL", "torchmetrics"}.isdisjoint(modules)
    assert {"mlflow", "mlflow-skinny", "matplotlib", "pandas"} <= set(distributions)


def test_training_needs_no_tracking(trained):
    folder, said = trained
    assert f"Writes   {folder}, metrics in {folder}/metrics.csv" in said
    assert f"Written  {folder}/checkpoints/best.ckpt, metrics in {folder}/metrics.csv" in said
    assert "MLflow" not in said
    assert {path.name for path in (folder / "checkpoints").iterdir()} >= {"best.ckpt", "last.ckpt"}
    assert {path.name for path in (folder / "panels").iterdir()} >= {"panels-000002.png", "bounces-000002.png"}


def test_its_metrics_are_a_table(trained):
    with open(trained[0] / "metrics.csv") as file:
        rows = list(csv.DictReader(file))
    by_step = {int(row["step"]): row for row in rows}
    assert [step for step, row in by_step.items() if row["train/loss"]] == list(range(STEPS))
    assert [step for step, row in by_step.items() if row["validation/log_l1"]] == [1]


def test_it_is_evaluated_without_tracking(trained, bare):
    folder = trained[0]
    said = bare(
        "launch/evaluate.py", "experiment=quickstart", f"data.root={folder.parent}/data", "logger=none", "device=cpu",
        f"checkpoint={folder}/checkpoints/best.ckpt", "evaluation.lpips=false", "evaluation.splits=[test]",
        extras=("evaluation",),
    )  # fmt: skip
    assert "names no MLflow run" in said
    splits = json.loads((folder / "evaluation" / "evaluation.json").read_text())["splits"]
    assert splits["test"]["model"]["log_l1"]["mean"] > 0


def test_a_picture_is_rendered_by_what_was_trained_and_by_what_comes_with_the_project(trained, bare, tmp_path):
    for name, checkpoint in (("own", trained[0] / "checkpoints" / "last.ckpt"), ("shipped", "radiosity")):
        bare(
            "launch/render.py", "scene=data/scenes/cornell_box.json", f"checkpoint={checkpoint}", "cameras=[0]",
            f"output={tmp_path}/{name}.exr", "resolution=32", "device=cpu",
        )  # fmt: skip
        assert (tmp_path / f"{name}.exr").is_file() and (tmp_path / f"{name}.png").is_file()


def test_rendering_imports_neither_lightning_nor_mlflow(bare):
    frameworks = "{'lightning', 'pytorch_lightning', 'mlflow', 'torchmetrics', 'torchvision', 'matplotlib'}"
    assert bare("-c", f"import sys, launch.render; print(sorted({frameworks} & sys.modules.keys()))") == "[]\n"


def test_a_network_is_loaded_without_pytorchs_compiler(bare):
    """The compiler takes as long to import as all of PyTorch."""
    load = "import sys, rfpp; rfpp.Renderer.load('radiosity', 'cpu'); print('torch._dynamo' in sys.modules)"
    assert bare("-c", load) == "False\n"


def test_a_command_prints_its_help(bare):
    said = bare("launch/benchmark.py", "benchmark=cost", "--help")
    assert "CSV file to write" in said and "rfpp.benchmark.cost" in said  # of the command, and of the benchmark


def test_benchmarks_other_than_plots_are_importable(bare):
    need_more = {"equal_time_plot"}
    folder = ROOT / "rfpp" / "benchmark"
    files = [path.relative_to(folder).with_suffix("") for path in folder.rglob("*.py") if path.stem != "__init__"]
    names = sorted({".".join(file.parts) for file in files} - need_more)
    bare("-c", "".join(f"import rfpp.benchmark.{name}\n" for name in names))


RENDER = ("launch/render.py", "cameras=[0]", "resolution=8", "device=cpu")
MISSED = {
    "training with tracking": ("tracking", ["launch/train.py", "experiment=quickstart", "data.root=absent"]),
    "an H5 scene": ("data", [*RENDER, "scene=absent.h5"]),
    "the viewer": ("viewer", ["launch/view.py", "scene=data/scenes/cornell_box.json"]),
    "the server": ("serve", ["launch/serve.py"]),
}


@pytest.mark.parametrize(("extra", "command"), MISSED.values(), ids=MISSED.keys())
def test_a_missing_extra_is_named_in_one_line(bare, extra, command):
    said = bare(*command, code=1)
    assert re.fullmatch(rf"error: .*pip install .*\[{extra}\]'\n", said), said


def test_the_default_loss_asks_for_the_extra_of_training(trained, bare):
    data = f"data.root={trained[0].parent}/data"
    said = bare(
        "launch/train.py", "experiment=quickstart", "debug=cpu", "logger=none", *SMALLEST, data, "data.resolution=8",
        code=1,
    )  # fmt: skip
    assert said == "error: lpips is not installed: pip install 'rfpp[training]'\n"


def test_a_model_of_the_registry_asks_for_tracking(bare, tmp_path):
    said = bare("launch/render.py", "scene=data/scenes/cornell_box.json", "checkpoint=models:/x/1", code=1)
    assert said == "error: mlflow is not installed: pip install 'rfpp[tracking]'\n"


def test_each_library_is_brought_by_the_extra_that_is_named():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    distributions = {"skimage": "scikit-image"}
    for module, extra in EXTRAS.items():
        brought = {canonicalize_name(Requirement(text).name) for text in extras[extra]}
        assert canonicalize_name(distributions.get(module, module)) in brought
    assert json.dumps(extras["all"]).count("rfpp[") == 1
