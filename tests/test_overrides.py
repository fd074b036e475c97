"""Nonsense for any setting of any command is refused in one line, and misspelled keys name what was meant."""

import copy
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from rfpp.commands import CONFIG_DIR
from rfpp.errors import UserError
from rfpp.overrides import defaults_of, names_setting, require_valid

COMMANDS = {"train": "experiment=large_scale", "generate": "experiment=study", "evaluate": "experiment=ablation",
            "refine": "experiment=rfpp_real", "benchmark": "benchmark=cost", "render/render": "motion=swing",
            "render/relight": "", "view": "", "serve/serve": ""}  # fmt: skip
NONSENSE = {bool: ["maybe", 3, "null"], int: ["many", -1, 0.5, "nan", "null", "[1]", 10**15],
            float: ["much", "inf", True, "null", 1e30], list: ["few", 3, "null"], str: ["''"]}  # fmt: skip
#: Settings with a number that may be null, or a list.
WIDER = {"callbacks.checkpoints.every_n_minutes": ["null"], "callbacks.divergence.patience": ["null"],
         "reference.token_bounces": ["null"], "resolution": ["null", "[1]"],
         "trainer.devices": ["null", "[1]"]}  # fmt: skip

#: Settings without a default whose type is not known before the command, or a group, has read them.
CHECKED_BY_THE_COMMAND = {"triangles", "up", "cameras", "camera.position", "camera.look_at", "camera.fov", "transports"}


def leaves(settings, prefix=""):
    for name, value in settings.items():
        yield from leaves(value, f"{prefix}{name}.") if isinstance(value, dict) else [(f"{prefix}{name}", value)]


@pytest.mark.parametrize("command", COMMANDS)
def test_nonsense_is_refused_for_every_leaf(command):
    folder, chosen = CONFIG_DIR / Path(command).parent, [group for group in [COMMANDS[command]] if group]
    with initialize_config_dir(str(folder), version_base="1.3"):
        defaults = defaults_of(Path(command).name, folder, [*chosen, "output=elsewhere"])
        require_valid(compose(Path(command).name, overrides=chosen), defaults, [*chosen])
    tried = 0
    for key, value in leaves(OmegaConf.to_container(defaults, resolve=False)):
        for wrong in NONSENSE.get(type(value), []):
            if wrong in WIDER.get(key, ["null"] if key.startswith("trainer.") else []):
                continue
            given = OmegaConf.from_dotlist([f"{key}={wrong}"])
            with pytest.raises(UserError, match=rf"{key}=.*( was expected; the default is |name a class)"):
                require_valid(given, defaults, [key])
            tried += 1
    assert tried >= 10


@pytest.mark.parametrize("command", COMMANDS)
def test_a_mapping_in_place_of_text_or_of_an_unset_value_is_refused(command):
    folder, chosen = CONFIG_DIR / Path(command).parent, [group for group in [COMMANDS[command]] if group]
    with initialize_config_dir(str(folder), version_base="1.3"):
        defaults = defaults_of(Path(command).name, folder, [*chosen, "output=elsewhere"])
    given, messages = copy.deepcopy(defaults), {}
    for key, value in leaves(OmegaConf.to_container(defaults, resolve=False)):
        if isinstance(value, str | None) and not key.endswith("_target_"):
            OmegaConf.update(given, key, {"a": 1}, merge=False)
            messages[key] = _message(given, defaults, key)
            OmegaConf.update(given, key, value, merge=False)
    assert {key for key in messages if not messages[key]} <= CHECKED_BY_THE_COMMAND
    assert all(message.startswith(f"{key}={{'a': 1}}: ") for key, message in messages.items() if message)


def _message(given, defaults, key):
    try:
        require_valid(given, defaults, [key])
    except UserError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("message", "named"),
    [
        ("camera.fov: input should be less than 180", True),
        ("camera: position is missing", True),
        ("camera.fov=-1: no negative number was expected", True),
        ("camera.look_at: input should be a valid tuple", False),
        ("camera images need Blender", False),
        ("/data/camera.fov: no such file", False),
        ("a.json: cannot be read", True),
        ("b.glb: cannot be read", True),
        ("shards/manifest.json: there is no finished data set here", True),
        ("a.json.gz: cannot be read", False),
        ("README.md: no scene", False),
        ("camera.fov is -1: use 1 or more", True),
        ("camera.fov isles: use 1 or more", False),
    ],
)
def test_an_error_names_a_setting_of_the_command_line_or_its_missing_file(message, named):
    assert names_setting(message, ["scene=['README.md','a.json',b.glb]", "camera.fov=-1", "data.root=shards"]) is named


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("lr=9", "lr: there is no such setting: did you mean optimizer.lr?"),
        ("stepz=9", "stepz: there is no such setting: did you mean steps?"),
        ("compile=true", "compile: there is no such setting: did you mean accelerate?"),
        (
            "datamodule.root=a",
            "datamodule.root: there is no such setting: did you mean datamodule.source.root?",
        ),
        ("trainer=null", "trainer=null: choose from auto, cpu, ddp"),
        ("~logger", "~logger: choose from mlflow, none, tensorboard, wandb"),
        ("=5", "=5: the name of the setting is missing: write <name>=5"),
        ("hydra.run.dir=/dev/null/x", "/dev/null/x: Not a directory: choose another place"),
        ("steps=many", "steps=many: a number was expected; the default is 20"),
        ("callbacks.checkpoints.folder=a", "callbacks.checkpoints.folder=a: is not in {run_dir}: set run_dir alone"),
        (
            "initial_weights=nonsense.ckpt",
            "nonsense.ckpt: no such checkpoint: train one with launch/train.py, or correct the path",
        ),
    ],
)
def test_commands_end_with_one_line_and_the_status_of_wrong_usage(given, said):
    command = [sys.executable, "launch/train.py", "debug=cpu", "run_dir=data/runs/unused", given]
    done = subprocess.run(command, cwd=CONFIG_DIR.parent, capture_output=True, text=True, check=False)
    said = said.format(run_dir=CONFIG_DIR.parent / "data/runs/unused")
    assert (done.returncode, done.stderr) == (2, f"error: {said}\n")


@pytest.mark.parametrize(
    ("command", "given", "said"),
    [
        ("train", "data.root=null", "valid string"),
        ("train", "data.views=0", "greater than or equal to 1"),
        ("train", "callbacks.checkpoints.keep=0", "greater than or equal to 1"),
        ("train", "callbacks.watchdog.minutes=2000000.0", "less than or equal to"),
        ("train", "trainer.val_check_interval=0", "greater than or equal to 1"),
        ("train", "optimizer._target_=nonsense", "name a class or function"),
        ("train", "datamodule.augmentation.color=3", "valid dictionary"),
        ("train", "optimizer._target_=torch.optim", "cannot be called"),
        ("train", "size.hidden=0", "greater than or equal to 1"),
        ("train", "steps=0", "greater than or equal to 1"),
        ("evaluate", "evaluation.splits=[]", "not empty"),
        ("evaluate", "evaluation.bootstrap.resamples=0", "greater than or equal to 1"),
        ("refine", "refining.samplings=[]", "not empty"),
        ("generate", "family.objects.kinds=[]", "not empty"),
        ("generate", "family.objects.held_out=0", "greater than 0"),
        ("generate", "family.placement.sizes.max_radius=0", "greater than 0"),
        ("evaluate", "model.transport.heads=0", "greater than or equal to 1"),
        ("evaluate", "size.encoder_layers=0", "greater than or equal to 1"),
        ("evaluate", "trainer.accelerator=abacus", "choose from"),
        ("evaluate", "trainer.devices=0", "greater than or equal to 1|'auto'"),
        ("train", "logger.tracking_uri=nonsense", "an address was expected"),
        ("train", "callbacks.best.monitor=nonsense", "a validation metric was expected"),
        ("view", "moving_seconds=0", "greater than 0"),
        ("view", "resolution=[]", "items|valid integer"),
        ("serve/serve", "port=70000", "less than or equal to 65535"),
        ("serve/serve", "max_megabytes=0", "greater than 0"),
    ],
)
def test_values_without_a_meaning_are_refused(command, given, said):
    folder = CONFIG_DIR / Path(command).parent
    with initialize_config_dir(str(folder), version_base="1.3"):
        defaults = defaults_of(Path(command).name, folder, [])
        cfg = compose(Path(command).name, overrides=[given])
    with pytest.raises(UserError, match=rf"{re.escape(given)}: .*({said})"):
        require_valid(cfg, defaults, [given])
