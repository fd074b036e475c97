"""Check the names and values that configuration files set, as `overrides` does for those of the command line."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import InterpolationResolutionError

from rfpp.declared_types import declared_problem
from rfpp.errors import UserError
from rfpp.overrides import REPLACED, suggestions


def require_valid_files(cfg: DictConfig, base: DictConfig, config_dir: Path, built: Collection[str] = ()) -> None:
    """Raise UserError for an unknown setting, a value in place of a section, or a value that its declared type refuses.

    Args:
        cfg: Configuration of a command with its experiment.
        base: The same command's configuration without an experiment.
        config_dir: Folder of the commands' configurations. Sections of other commands are allowed, because commands
            share experiments.
        built: Sections whose constructors the command calls; empty for all. The classes of others are not imported.
    """
    others = {name for file in config_dir.glob("*.yaml") for name in OmegaConf.load(file)}
    known = {*base, *others, *(folder.name for folder in config_dir.iterdir())}
    for _, key in sorted(_keys(cfg), key=itemgetter(0)):  # those that others refer to first
        section, _, name = key.rpartition(".")
        before = OmegaConf.select(base, section) if section else base
        takes_any = not isinstance(before, DictConfig) or "_target_" in before or (section and _is_part(cfg, key))
        if not takes_any and name not in (before if section else known):
            similar = suggestions(key, base)
            raise UserError(
                f"{key}: there is no such setting: {f'did you mean {similar[0]}?' if similar else 'see --help'}"
            )
        if not built or not section or section.partition(".")[0] in built:
            _require_value(cfg, base, key)


def _is_part(cfg: DictConfig, key: str) -> bool:
    """Return whether a setting constructs something, such as a further callback."""
    value = OmegaConf.select(cfg, key, throw_on_resolution_failure=False)
    return isinstance(value, DictConfig) and "_target_" in value


def _require_value(cfg: DictConfig, base: DictConfig, key: str) -> None:
    try:
        value = OmegaConf.select(cfg, key)
    except InterpolationResolutionError as error:
        raise UserError(f"{key}: {str(error).splitlines()[0]}") from error
    before = OmegaConf.select(base, key, throw_on_resolution_failure=False)
    if key in REPLACED and value == REPLACED[key]:
        return
    problem = None
    if "." not in key and isinstance(before, DictConfig) and not isinstance(value, DictConfig):
        problem = f"settings were expected, such as {key}.{next(iter(before))}"
    elif isinstance(before, DictConfig) and "_target_" in before and isinstance(value, DictConfig):
        problem = None if "_target_" in value else "`_target_` is missing"
    elif not _holds_parts(value):
        problem = declared_problem(cfg, key, before)
    if problem:
        raise UserError(f"{key}={'null' if value is None else value}: {problem}")


def _holds_parts(value: Any) -> bool:
    """Return whether a section has constructors below it, whose arguments are checked one by one."""
    if OmegaConf.is_config(value):
        return _holds_parts(OmegaConf.to_container(value, resolve=False))
    return isinstance(value, dict) and ("_target_" in value or any(map(_holds_parts, value.values())))


def _keys(cfg: DictConfig, prefix: str = "") -> Iterator[tuple[bool, str]]:
    """Yield whether a setting or section refers to another, and its name, with dots; unset ones are omitted."""
    for name in cfg:
        if OmegaConf.is_missing(cfg, name):
            continue
        refers = OmegaConf.is_interpolation(cfg, name)
        yield refers, f"{prefix}{name}"
        if not refers and isinstance(cfg[name], DictConfig):
            yield from _keys(cfg[name], f"{prefix}{name}.")
