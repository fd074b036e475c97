"""Composition and error messages of all commands."""

import errno
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hydra.utils import instantiate

from rfpp.commands import entry_point, settings, with_groups, with_scenes, without_plus
from rfpp.errors import UserError

ROOT = Path(__file__).parents[1]


def test_a_plus_before_experiment_and_debug_is_dropped():
    given = ["-m", "+experiment=[ablation,known_light]", "experiment=quickstart", "+debug=cpu", "+x=+experiment=a"]
    expected = ["-m", "experiment=[ablation,known_light]", "experiment=quickstart", "debug=cpu", "+x=+experiment=a"]
    assert without_plus(given) == expected


def test_plain_file_names_are_scenes():
    assert with_scenes(["chair.glb", "fov=3", "--cfg", "job"]) == ["fov=3", "--cfg", "job", "scene='chair.glb'"]
    assert with_scenes(["it's.OBJ", "b.json"]) == [r"scene=['it\'s.OBJ','b.json']"]
    assert with_scenes(["scene=a.json", "-m"]) == ["scene=a.json", "-m"]


def test_groups_may_be_chosen_with_dots():
    given = ["datamodule.reader=webdataset", "datamodule.reader.buffer=2", "size.width=64", "model.tokenizer=none"]
    assert with_groups(given) == ["datamodule/reader=webdataset", *given[1:]]


def test_the_command_line_takes_a_plus():
    """Hydra itself refuses it for a group that has a default."""
    command = [sys.executable, "launch/generate.py", "+experiment=quickstart", "--cfg", "job"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "name: quickstart" in done.stdout


def test_settings_by_name_include_their_defaults():
    key, cycles = ("reference", "reference_settings"), {"without": ["radiosity"]}
    unclamped, preview = (settings(*key, name, **cycles) for name in ("unclamped", "preview"))
    assert unclamped == {**preview, "samples": 32, "clamp_indirect": 0.0} and preview.samples == 16
    with pytest.raises(UserError, match=r"reference_settings=best: choose from paper, preview, training, unclamped"):
        settings(*key, "best", **cycles)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("calendar.first.month=13", "error: calendar.first: month must be in 1..12\n"),
        ("+calendar.first.color=1", "error: calendar.first: .*keyword argument.*\n"),
        ("calendar.share.denominator=0", "error: calendar.share: Fraction.*0.*\n"),
        ("calendar.meshes.up=x", "error: calendar.meshes.up is 'x': choose y or z\n"),
    ],
)
def test_an_invalid_value_is_reported_in_one_line(given, said, tmp_path, monkeypatch, capsys):
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "days.yaml").write_text(
        "calendar:\n  first: {_target_: datetime.date, year: 2026, month: 1, day: 1}\n"
        "  share: {_target_: fractions.Fraction, numerator: 1, denominator: 7}\n"
        "  meshes: {_target_: rfpp.scene.sampling.objects.preparation.Preparation, max_faces: 9, min_faces: 1,\n"
        "           non_watertight: keep, most_parts: 1, up: z}\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["days", given])
    with pytest.raises(SystemExit, match="2"):
        entry_point("days", tmp_path / "conf")(lambda cfg: instantiate(cfg.calendar))()
    assert re.fullmatch(said, capsys.readouterr().err)


@pytest.mark.parametrize(
    ("reason", "file", "status", "said"),
    [
        (errno.ENOTDIR, "runs/mine/a", "2", "runs/mine/a: Not a directory: choose another place"),
        (errno.ENOSPC, "runs/mine/a", "1", "runs/mine/a: No space left on device: free some space and run"),
    ],
)
def test_folders_that_cannot_be_used_and_full_disks_are_told_apart(
    reason, file, status, said, tmp_path, monkeypatch, capsys
):
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "days.yaml").write_text("folder: runs\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["days", "folder=runs/mine"])

    def fail(cfg):
        raise OSError(reason, os.strerror(reason), file)

    with pytest.raises(SystemExit, match=status):
        entry_point("days", tmp_path / "conf")(fail)()
    assert said in capsys.readouterr().err


def test_an_interrupted_command_ends_with_one_line_and_by_the_signal():
    begun = "import os, signal, rfpp.commands; os.kill(os.getpid(), signal.SIGINT)"
    done = subprocess.run([sys.executable, "-c", begun], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.stderr == "interrupted: run the same command again\n"
    assert done.returncode == -signal.SIGINT


#: Every command but training, which handles Ctrl-C itself.
COMMANDS = sorted(file.stem for file in (ROOT / "launch").glob("*.py") if file.stem != "train")


@pytest.mark.parametrize("command", COMMANDS)
def test_control_c_during_imports_prints_one_line(command):
    program = f"""
import os, runpy, signal, sys

class ControlC:  # at the first import of a library
    def find_spec(self, name, path, target=None):
        if name in ("hydra", "numpy", "omegaconf", "rich", "torch", "lightning"):
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, ControlC())
runpy.run_path("launch/{command}.py", run_name="__main__")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.stderr == "interrupted: run the same command again\n"
    assert done.returncode == -signal.SIGINT
