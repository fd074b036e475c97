"""Shared by all files in launch/: Hydra composition and one-line messages for user errors."""

from __future__ import annotations

import errno
import functools
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import hydra
from hydra.errors import ConfigCompositionException, InstantiationException, OverrideParseException
from omegaconf import DictConfig, OmegaConf

import rfpp.interrupts  # noqa: F401 (what ends a command from outside is said in one line)
from rfpp.allocator import keep_freed_memory
from rfpp.errors import UserError
from rfpp.extras import missing_extra
from rfpp.folders import carried

Result = TypeVar("Result")

#: The ways in which a disk can be full: no space, quota used up, file-size limit reached.
NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
#: SQLite's words for it, which reach us in an exception of MLflow's.
SQLITE_NO_SPACE = "database or disk is full"

#: What a constructor raises that is given a value or a key it cannot take.
_IMPOSSIBLE_VALUES = (ValueError, TypeError, ArithmeticError, RuntimeError)
#: Groups that had no default once and were added with a plus.
_ONCE_ADDED = ("+experiment=", "+debug=")

#: Hydra's primary configurations and groups.
CONFIG_DIR = carried("conf", "_conf")


def entry_point(
    config_name: str, config_dir: Path = CONFIG_DIR
) -> Callable[[Callable[[DictConfig], Result]], Callable[[], Result]]:
    """Decorate `task(cfg)` into a command that composes `<config_dir>/<config_name>.yaml` and the command line.

    A `UserError` is printed as one line on stderr and the process exits with status 1. The undecorated task
    stays available as `command.__wrapped__` for callers that have composed a config themselves.
    """

    def decorate(task: Callable[[DictConfig], Result]) -> Callable[[], Result]:
        @functools.wraps(task)
        def reporting(cfg: DictConfig) -> Result:
            warnings.formatwarning = _one_line
            keep_freed_memory()
            try:
                return task(cfg)
            except UserError as error:
                _fail(error)
            except InstantiationException as error:  # Hydra's wrapping of what a constructor raised
                if isinstance(reason := missing_extra(error) or error.__cause__, UserError):
                    _fail(reason)
                if not isinstance(reason, _IMPOSSIBLE_VALUES):
                    raise
                _fail(UserError(f"{str(error).rpartition('full_key: ')[2]}: {reason}"))
            except OSError as error:  # out of the hands of a library that was writing
                if error.errno not in NO_SPACE:
                    raise
                where = error.filename or "while writing"
                _fail(UserError(f"{where}: {error.strerror}: free some space and run the same command again"))
            except Exception as error:
                if missing := missing_extra(error):
                    _fail(missing)
                if SQLITE_NO_SPACE not in str(error):
                    raise
                _fail(UserError(f"{SQLITE_NO_SPACE}: free some space and run the same command again"))

        composed = hydra.main(version_base="1.3", config_path=str(config_dir), config_name=config_name)(reporting)

        @functools.wraps(reporting)
        def command() -> Result:
            sys.argv[1:] = without_plus(sys.argv[1:])
            os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then leaves its errors to us, and a defect its whole traceback
            try:
                return composed()
            except (ConfigCompositionException, OverrideParseException) as error:
                _fail(UserError(" ".join(f"{error} {error.__cause__ or ''}".split())))

        return command

    return decorate


def without_plus(arguments: Sequence[str]) -> list[str]:
    """The command line with `experiment=…` for `+experiment=…`, which Hydra refuses for a group that has a default."""
    return [given[1:] if given.startswith(_ONCE_ADDED) else given for given in arguments]


def _fail(error: UserError) -> NoReturn:
    print(f"error: {error}", file=sys.stderr)
    sys.exit(1)


def _one_line(message: Warning | str, category: type[Warning], *_: object) -> str:
    return f"{'warning' if category is UserWarning else category.__name__}: {message}\n"


def required(cfg: DictConfig, key: str) -> Any:
    """A value that only the command line can give. Raises UserError when it is missing."""
    if OmegaConf.is_missing(cfg, key):
        raise UserError(f"{key} is not given: add {key}=… to the command line")
    return cfg[key]


def settings(group: str, key: str, name: str) -> DictConfig:
    """conf/<group>/<name>.yaml, for a key of the command line whose value is such a name.

    Raises UserError with the names there are.
    """
    files = {file.stem: file for file in sorted((CONFIG_DIR / group).glob("*.yaml"))}
    if name not in files:
        raise UserError(f"{key}={name}: choose from {', '.join(files)}")
    chosen = OmegaConf.load(files[name])
    of_group = [parent for parent in chosen.pop("defaults", ["_self_"]) if parent != "_self_"]
    return OmegaConf.merge(*(settings(group, key, parent) for parent in of_group), chosen)
