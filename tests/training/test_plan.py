import warnings

import pytest
import torch

from rfpp.errors import UserError
from rfpp.training.plan import choose_acceleration, choose_precision, plan_training

BFLOAT16, NONE = {"avx512_bf16": True}, {"avx512_f": True}
TRAINER = {
    "devices": 2, "num_nodes": 3, "accelerator": "cpu", "precision": "32-true", "val_check_interval": 100,
    "max_steps": 500,
}  # fmt: skip


def planned(**change):
    return plan_training({**TRAINER, **change}, "32-true", lambda ranks: 24 // ranks)


def test_ranks_share_the_batches_of_a_step():
    plan = planned()
    assert (plan.ranks, plan.accumulate_grad_batches) == (6, 4)
    assert planned(devices=[0, 2, 5], num_nodes=1).ranks == 3


def test_the_validation_interval_counts_steps_and_ends_with_a_short_run():
    assert planned().val_check_interval == 100 * 4
    assert planned(max_steps=30).val_check_interval == 30 * 4


@pytest.mark.parametrize("devices", ["auto", -1, 0, "2"])
def test_devices_must_be_a_number(devices):
    with pytest.raises(UserError, match=f"trainer.devices={devices}: give the number of devices per node"):
        planned(devices=devices)


def run_with(folder, precision):
    (folder / "checkpoints").mkdir()
    (folder / "config.yaml").write_text(f"plan:\n  precision: {precision}\n")
    return folder / "checkpoints" / "step-00000004.ckpt"


@pytest.mark.parametrize(("capabilities", "expected"), [(BFLOAT16, "bf16-mixed"), (NONE, "32-true")])
def test_automatic_precision_follows_the_processor(capabilities, expected, monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities)
    assert choose_precision("auto", "cpu", None) == expected


@pytest.mark.parametrize("before", ["32-true", "bf16-mixed"])
def test_a_resumed_run_keeps_its_precision_on_any_machine(before, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: NONE if before == "bf16-mixed" else BFLOAT16)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert choose_precision("auto", "cpu", run_with(tmp_path, before)) == before


def test_a_change_of_precision_is_warned_of(tmp_path):
    with pytest.warns(UserWarning, match="was trained in 32-true and continues in trainer.precision=bf16-mixed"):
        assert choose_precision("bf16-mixed", "cpu", run_with(tmp_path, "32-true")) == "bf16-mixed"


@pytest.mark.parametrize(
    ("setting", "accelerator", "precision", "checkpointing", "expected"),
    [("auto", "cuda", "bf16-mixed", None, "graphs"), ("auto", "cuda", "32-true", None, "none"),
     ("auto", "cuda", "bf16-mixed", object(), "none"), ("auto", "cpu", "bf16-mixed", None, "none"),
     ("compiled", "cuda", "bf16-mixed", None, "compiled"), ("none", "cuda", "bf16-mixed", None, "none")],
)  # fmt: skip
def test_steps_are_accelerated_where_they_can_be(setting, accelerator, precision, checkpointing, expected, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert choose_acceleration(setting, accelerator, precision, checkpointing) == expected


@pytest.mark.parametrize("setting", ["graphs", "compiled"])
def test_an_impossible_acceleration_is_refused(setting):
    with pytest.raises(UserError, match=f"accelerate={setting} needs a GPU"):
        choose_acceleration(setting, "cpu", "bf16-mixed", None)
    with pytest.raises(UserError, match="accelerate=yes: choose from auto, none, graphs, compiled"):
        choose_acceleration("yes", "cpu", "bf16-mixed", None)
