"""Check settings of the command line against the values that they replace."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import hydra
from omegaconf import DictConfig, ListConfig, OmegaConf

from rfpp.declared_types import declared_problem, is_argument
from rfpp.errors import UserError, one_line

#: Numbers in whose place a list may be given.
_ONE_OR_MORE = ("resolution", "trainer.devices")
#: Settings that may be null although their default is not; Lightning has more of them, and so may one that is `auto`.
_NULLABLE = (
    "resolution",
    "animation",
    "callbacks.checkpoints.every_n_minutes",
    "callbacks.divergence.patience",
    "reference.token_bounces",
)
#: Ends of the names of lists that may be empty although their defaults are not.
_MAY_BE_EMPTY = ".gbuffer_channels"
#: What Hydra does not take for the name of a file.
_NO_NAME = re.compile(r"null|true|false|[-+]?[\d.]+(e[-+]?\d+)?|\{.*", re.IGNORECASE)
#: Numbers from here on have no meaning in any setting.
_HUGE = 1e15
#: Values that are replaced before a constructor receives them.
REPLACED = {"trainer.precision": "auto"}
#: Settings of version 0.1 whose new names are not similar.
_RENAMED = {
    "callbacks.life": "callbacks.ablation",
    "compile": "accelerate",
    "datamodule.colour_augmentation": "datamodule.augmentation.color",
    "datamodule.dealing": "datamodule.batching.partition",
    "datamodule.rigid_augmentation": "datamodule.augmentation.rigid",
    "evaluation.life_scenes": "evaluation.ablation_scenes",
}


def defaults_of(config_name: str, config_dir: Path, overrides: Sequence[str]) -> DictConfig:
    """Compose a configuration with the groups that `overrides` choose, without their values; Hydra is initialized."""
    groups = [given for given in overrides if (config_dir / _key(given).partition("@")[0]).is_dir()]
    return hydra.compose(config_name, overrides=groups)


def require_valid(cfg: DictConfig, defaults: DictConfig, overrides: Sequence[str]) -> None:
    """Raise UserError for a value that has another type than its default, is empty, null, huge, or negative.

    A number is negative against expectation if its default is not. A value that is an argument of a constructor is also
    checked against the constructor's annotations; others without a default are not checked.
    """
    for key in map(_key, overrides):
        _require(cfg, defaults, key)


def _require(cfg: DictConfig, defaults: DictConfig, key: str) -> None:
    before, value = (OmegaConf.select(each, key, throw_on_resolution_failure=False) for each in (defaults, cfg))
    if isinstance(before, DictConfig) and isinstance(value, DictConfig):
        if "_target_" in before and "_target_" not in value:
            raise UserError(f"{key}={value}: `_target_` is missing: add it, or set single values, as in {key}.name=…")
        for name in before.keys() & value.keys():
            _require(cfg, defaults, f"{key}.{name}")
        return
    shown = "null" if value is None else value
    if key.endswith("._target_"):
        _require_importable(key, value)
    expected = _expected(before, value)
    if isinstance(before, str) and not isinstance(value, str) and not is_argument(cfg, key):
        expected = "text, quoted if it looks like a number,"
    if value == "" and before != "":
        expected = "text that is not empty"
    if value == [] and isinstance(before, ListConfig) and len(before) and not key.endswith(_MAY_BE_EMPTY):
        expected = "a list that is not empty"
    if expected and not _is_exception(key, before, value):
        raise UserError(f"{key}={shown}: {expected} was expected; the default is {before}")
    is_replaced = key in REPLACED and value == REPLACED[key]
    if not is_replaced and (problem := declared_problem(cfg, key, before)):
        raise UserError(f"{key}={shown}: {problem}")


def _require_importable(key: str, name: Any) -> None:
    try:
        reason = "" if callable(resolve_name(name)) else "cannot be called"
    except (ImportError, ValueError, TypeError, AttributeError) as error:
        reason = one_line(str(error))
    if reason:
        raise UserError(f"{key}={name}: {reason}: name a class or function, with its module")


def names_setting(message: str, overrides: Sequence[str]) -> bool:
    """Return whether an error begins with a setting of the command line, a part of one, or a group that has one.

    The value of a setting counts as well if it is the path of a file that does not exist.
    """
    path = message.partition(": ")[0]
    if any(_holds(value, path) for value in _values(overrides) if not os.path.exists(value)):  # Path.exists may raise
        return True
    if not (start := re.match(r"([\w.]+)([:=]| is )", message)):
        return False
    named, keys = start[1], map(_key, overrides)
    return any(named == key or named.startswith(f"{key}.") or key.startswith(f"{named}.") for key in keys)


def names_path(path: str, overrides: Sequence[str]) -> bool:
    """Return whether `path` is the value of a setting, or lies in a folder that is."""
    return any(_holds(value, path) or _holds(str(Path(value).absolute()), path) for value in _values(overrides))


def _values(overrides: Sequence[str]) -> set[str]:
    return {value for given in overrides for value in re.split("[][,'\"]", given.partition("=")[2]) if value}


def _holds(folder: str, path: str) -> bool:
    return path == folder or path.startswith(f"{folder}/")


def require_group_names(overrides: Sequence[str], config_dir: Path) -> None:
    """Raise UserError for a group of settings that is deleted, or set to something else than the name of a file."""
    for given in overrides:
        key, sign, value = given.lstrip("+").partition("=")
        if sign and not key:
            raise UserError(f"{given}: the name of the setting is missing: write <name>{given}")
        folder = config_dir / key.lstrip("~").partition("@")[0]
        if key and os.path.isdir(folder) and (key.startswith("~") or (sign and _NO_NAME.fullmatch(value))):
            names = ", ".join(sorted(file.stem for file in folder.glob("*.yaml")))
            raise UserError(f"{given}: choose from {names}")


def suggestions(key: str, defaults: DictConfig) -> list[str]:
    """Return the new name of `key`, or up to three of which it, or its last part, may be a misspelling."""
    if key in _RENAMED:
        return [_RENAMED[key]]
    every = _keys(OmegaConf.to_container(defaults, resolve=False))
    known = [name for name in every if not key.startswith(f"{name}.")]
    ends = {name: name.rpartition(".")[2] for name in known}
    similar = get_close_matches(key.rpartition(".")[2], sorted(set(ends.values())), 3, 0.75)
    same_end = [name for end in similar for name in known if ends[name] == end]
    return get_close_matches(key, known, 3, 0.8) or same_end[:3]


def _key(override: str) -> str:
    return override.lstrip("+~").partition("=")[0]


def _is_exception(key: str, before: Any, value: Any) -> bool:
    if value is None:
        return key in _NULLABLE or before == "auto" or key.startswith("trainer.")
    return key in _ONE_OR_MORE and isinstance(value, ListConfig)


def _expected(before: Any, value: Any) -> str | None:
    """Return the kind of value expected in place of `value`; None if it may be right."""
    if before is None or isinstance(before, str) or OmegaConf.is_dict(before):
        return None
    if isinstance(before, bool):
        return None if isinstance(value, bool) else "true or false"
    if isinstance(before, ListConfig):
        typical = next(iter(before), None)
        if isinstance(value, ListConfig) and not any(_expected(typical, each) == "a number" for each in value):
            return None
        return "a list of numbers" if isinstance(typical, int | float) else "a list"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "a number"
    if isinstance(before, int) and not isinstance(value, int):
        return "a whole number"
    if not math.isfinite(value) and math.isfinite(before):
        return "a finite number"
    if abs(value) >= _HUGE > abs(before):
        return f"a number below {_HUGE:g}"
    expects_sign = before > 0 or (isinstance(before, int) and before == 0)
    return "no negative number" if value < 0 and expects_sign else None


def _keys(settings: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for name, value in settings.items():
        yield f"{prefix}{name}"
        if isinstance(value, dict):
            yield from _keys(value, f"{prefix}{name}.")
