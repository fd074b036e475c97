"""Training computes in what its device is fast in, unless it is told otherwise or has begun otherwise."""

import warnings

import pytest
import torch
from omegaconf import OmegaConf
from small_data import make
from training_runs import train

from rfpp.training.precision import training_precision

BFLOAT16, NONE = {"avx512_bf16": True}, {"avx512_f": True}


def resumed(folder, precision):
    (folder / "checkpoints").mkdir()
    (folder / "config.yaml").write_text(f"trainer:\n  precision: {precision}\n")
    return folder / "checkpoints" / "step-00000004.ckpt"


@pytest.mark.parametrize(("capabilities", "expected"), [(BFLOAT16, "bf16-mixed"), (NONE, "32-true")])
def test_by_itself_it_is_what_the_processor_has_instructions_for(capabilities, expected, monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities)
    assert training_precision("auto", "cpu", None) == expected


@pytest.mark.parametrize("chosen", ["32-true", "bf16-mixed"])
def test_what_is_chosen_wins(chosen, monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: NONE)
    assert training_precision(chosen, "cpu", None) == chosen


@pytest.mark.parametrize("begun", ["32-true", "bf16-mixed"])
def test_a_run_goes_on_in_what_it_was_begun_in_on_any_machine(begun, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: NONE if begun == "bf16-mixed" else BFLOAT16)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert training_precision("auto", "cpu", resumed(tmp_path, begun)) == begun


def test_going_on_in_another_is_said(tmp_path):
    with pytest.warns(UserWarning, match="trained in 32-true until here, goes on in trainer.precision=bf16-mixed"):
        assert training_precision("bf16-mixed", "cpu", resumed(tmp_path, "32-true")) == "bf16-mixed"


def test_a_run_writes_down_what_was_decided(tmp_path):
    data = make(tmp_path / "small", splits={"train": 4, "validation": 2}).root
    (tmp_path / "runs").mkdir()
    train(tmp_path / "runs" / "run", data, "logger=none", "steps=1", "trainer.val_check_interval=1")
    written = OmegaConf.load(tmp_path / "runs" / "run" / "config.yaml").trainer.precision
    assert written == training_precision("auto", "cpu", None)
