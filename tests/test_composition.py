"""Nonsense in a configuration file is refused in one line, before anything is built."""

import subprocess
import sys

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from rfpp.commands import CONFIG_DIR
from rfpp.composition import require_valid_files
from rfpp.errors import UserError


@pytest.mark.slow
@pytest.mark.parametrize("command", ["train", "generate", "evaluate", "refine"])
def test_every_experiment_is_valid_in_every_command(command):
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        base = compose(command)
        for file in sorted(CONFIG_DIR.glob("experiment/**/*.yaml")):
            experiment = file.relative_to(CONFIG_DIR / "experiment").with_suffix("")
            require_valid_files(compose(command, overrides=[f"experiment={experiment}"]), base, CONFIG_DIR)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"seed": "abc"}, "seed=abc: input should be a valid integer"),
        ({"seed": -5}, "seed=-5: input should be greater than or equal to 0"),
        ({"data": {"views": None}}, "data.views=null: input should be a valid integer"),
        ({"data": {"splits": {"train": "many"}}}, r"data.splits=\{.*'many'.*: input should be a valid integer"),
        ({"schedule": {"warmup_steps": "${nothing}"}}, "schedule.warmup_steps: Interpolation key 'nothing' not found"),
        ({"stepz": 3}, "stepz: there is no such setting: did you mean steps"),
        ({"evaluation": {"splits": "test"}}, "evaluation.splits=test: input should be a valid list"),
        ({"trainer": None}, "trainer=null: settings were expected, such as trainer._target_"),
        ({"family": 5}, "family=5: settings were expected, such as family.objects"),
        ({"family": {"objects": 5}}, "family.objects=5: input should be an instance of ObjectSource"),
        ({"optimizer": {"lr": 0}}, "optimizer.lr=0: input should be greater than 0"),
        ({"trainer": {"precision": "half"}}, "trainer.precision=half: choose from"),
        ({"size": {"width": "wide"}}, "size.width=wide: input should be a valid integer"),
    ],
)
def test_a_value_of_a_file_is_checked(given, said):
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        base = compose("train", overrides=["experiment=quickstart"])
    cfg = OmegaConf.create(OmegaConf.to_container(base))
    for name, value in given.items():
        merged = OmegaConf.merge(cfg[name], value) if isinstance(value, dict) and name in cfg else value
        OmegaConf.update(cfg, name, merged, merge=False)
    with pytest.raises(UserError, match=f"^{said}"):
        require_valid_files(cfg, base, CONFIG_DIR)


def test_sections_that_a_command_does_not_build_are_not_checked():
    """Their classes need packages that the command may lack."""
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        base = compose("generate")
    cfg = OmegaConf.merge(base, {"trainer": {"gradient_clip_val": "half"}})
    require_valid_files(cfg, base, CONFIG_DIR, built=["data", "family"])
    with pytest.raises(UserError, match="trainer.gradient_clip_val=half"):
        require_valid_files(cfg, base, CONFIG_DIR)


def test_sections_of_parts_take_further_ones():
    mine = "+callbacks.mine._target_=lightning.pytorch.callbacks.Timer"
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        base, *others = (
            compose("train", overrides=given) for given in ([], [mine], [mine, "+callbacks.mine.interval=[]"])
        )
    require_valid_files(others[0], base, CONFIG_DIR)
    with pytest.raises(UserError, match="callbacks.mine.interval"):
        require_valid_files(others[1], base, CONFIG_DIR)


def test_an_experiment_of_ones_own_is_refused_in_one_line(tmp_path):
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment/mine.yaml").write_text("# @package _global_\nsteps: many\n")
    command = [sys.executable, "launch/train.py", "--config-dir", str(tmp_path), "experiment=mine"]
    done = subprocess.run(command, cwd=CONFIG_DIR.parent, capture_output=True, text=True, check=False)
    said = "error: steps=many: input should be a valid integer, unable to parse string as an integer\n"
    assert (done.returncode, done.stderr) == (2, said)
