"""`benchmark=gpu`: without a card, and what it would measure on one."""

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from marks import requires_gpu
from omegaconf import OmegaConf

from rfpp.benchmark.cost.case import Case
from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError
from rfpp.training.plan import ACCELERATIONS


def configuration(*overrides):
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        return compose("benchmark", overrides=["benchmark=gpu", "benchmark.size=tiny", *overrides]).benchmark


def test_without_a_gpu_it_is_one_line(monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    measure = instantiate(configuration(), _convert_="all")
    with pytest.raises(UserError, match="benchmark=gpu: PyTorch finds no GPU: benchmark=cost measures on a CPU"):
        list(measure(progress=lambda done, total: None))


def test_every_group_is_a_case():
    settings = OmegaConf.to_container(configuration(), resolve=False)
    for group in settings["groups"]:
        assert group.pop("acceleration", "graphs") in ACCELERATIONS
        assert set(group.pop("quantities")) <= {"training_step", "encode", "view"}
        Case(**{**{k: v for k, v in settings["case"].items() if k != "_target_"}, **group})


@requires_gpu
def test_rows_are_kept_and_not_measured_again(tmp_path):
    groups = "benchmark.groups=[{quantities: [training_step, view], triangles: 200, objects: 5, resolution: 32}]"
    measure = instantiate(configuration(groups, "size=tiny", "benchmark.seconds=0.01"), _convert_="all")
    rows = list(measure(progress=lambda done, total: None))
    measured = [(row["network"], row["quantity"], row["status"]) for row in rows]
    assert measured == [(n, q, "ok") for n in ("RenderFormer", "RenderFormer++") for q in ("training_step", "view")]
    assert all(row["kernels"] > 100 and row["seconds"] > 0 for row in rows)
