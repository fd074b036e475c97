"""Help of the commands: the settings of their YAML files with the comments in them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml

_NOT_SETTINGS = re.compile(r"^(?:defaults|hydra):.*\n(?:(?: .*)?\n)*|^# @package.*\n", re.MULTILINE)
#: Groups whose names include folders, as in experiment=paper/without_pitg.
_WITH_FOLDERS = ("experiment",)


def help_text(about: str, config_name: str, config_dir: Path, overrides: Sequence[str] = ()) -> str:
    """Return a command's description, its settings, the files that `overrides` choose, and the choices of each group.

    Args:
        about: Docstring of the command's module.
        config_name: Primary configuration, <config_dir>/<config_name>.yaml.
        overrides: Arguments of the command line, such as experiment=quickstart.
    """
    primary = config_dir / f"{config_name}.yaml"
    files = [primary, *(config_dir / f"{name}.yaml" for name in _defaults(primary) if isinstance(name, str))]
    groups = dict.fromkeys(group for file in files for group in _groups(file, config_dir))
    pairs = (given.partition("=") for given in overrides)
    files += [file for group, _, name in pairs if (file := config_dir / group / f"{name}.yaml").is_file()]
    parts = [about.strip(), "Settings, changed by <setting>=<value>:"]
    parts += [_NOT_SETTINGS.sub("", file.read_text(encoding="utf-8")).strip() for file in files if file.is_file()]
    choices = [
        f"  {name + '=':<26}{', '.join(names)}" for group in groups for name, names in _choices(group, config_dir)
    ]
    parts += ["Groups of settings, chosen by <group>=<name>; with --help, the chosen file is shown:"] * bool(choices)
    parts += ["\n".join(choices)] * bool(choices)
    return "\n\n".join([*parts, "All settings with their values: --cfg job. Several values at once: -m."])


def _defaults(file: Path) -> list[Any]:
    return yaml.safe_load(file.read_text(encoding="utf-8")).get("defaults", []) if file.is_file() else []


def _groups(file: Path, config_dir: Path) -> list[str]:
    names = [str(name) for entry in _defaults(file) if isinstance(entry, dict) for name in entry]
    plain = [name.lstrip("/").partition("@")[0] for name in names if not name.startswith("override ")]
    return [name for name in plain if (config_dir / name).is_dir()]


def _choices(group: str, config_dir: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield a group and its names, and the same for each group in it."""
    folder = config_dir / group
    files = folder.rglob("*.yaml") if group in _WITH_FOLDERS else folder.glob("*.yaml")
    yield group, sorted(str(file.relative_to(folder).with_suffix("")) for file in files)
    if group not in _WITH_FOLDERS:
        for inner in sorted(path.name for path in folder.iterdir() if path.is_dir()):
            yield from _choices(f"{group}/{inner}", config_dir)
