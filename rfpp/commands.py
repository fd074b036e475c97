"""Hydra composition and one-line error messages for all files in launch/."""

from __future__ import annotations

import errno
import functools
import os
import re
import sys
import time
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import ConfigCompositionException, HydraException, InstantiationException, OverrideParseException
from omegaconf import DictConfig, OmegaConf

import rfpp.interrupts  # noqa: F401 (one-line messages for Ctrl-C and missing extras)
from rfpp.allocator import keep_freed_memory
from rfpp.command_help import help_text
from rfpp.composition import require_valid_files
from rfpp.errors import UserError, one_line
from rfpp.extras import missing_extra
from rfpp.files import write_atomically
from rfpp.folders import carried
from rfpp.overrides import defaults_of, names_path, names_setting, require_group_names, require_valid, suggestions

Result = TypeVar("Result")

#: Exit status after an invalid command line.
USAGE = 2
#: Errors of a full disk: no space, quota used up, file-size limit reached.
NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
#: Errors of a path that cannot be a file or folder of ours.
_UNUSABLE = (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.EACCES, errno.EPERM, errno.EROFS,
             errno.ENAMETOOLONG, errno.ELOOP)  # fmt: skip
#: SQLite's message for a full disk, which MLflow raises in an exception of its own.
SQLITE_NO_SPACE = "database or disk is full"

#: Exceptions of constructors that receive an invalid value or an unknown key.
_INVALID_VALUE = (ValueError, TypeError, ArithmeticError, RuntimeError)

#: Groups of settings for all sections. They may be given with a plus, as in Hydra's documentation.
_SHARED = ("experiment=", "debug=")

_SCENE_FILE = re.compile(r"[^-=][^=]*\.(json|h5|glb|gltf|obj|ply|stl)", re.IGNORECASE)

#: Folder of Hydra's primary configurations and groups.
CONFIG_DIR = carried("conf", "_conf")


def entry_point(
    config_name: str, config_dir: Path = CONFIG_DIR, built: Collection[str] = ()
) -> Callable[[Callable[[DictConfig], Result]], Callable[[], Result | None]]:
    """Decorate `task(cfg)` into a command that composes `<config_dir>/<config_name>.yaml` and the command line.

    A `UserError` is printed as one line on stderr and the process exits with status 1, or 2 if a setting is unknown,
    is invalid or names a file that does not exist. The undecorated task is available as `command.__wrapped__`.
    `built` names the sections whose classes the command imports; all by default.
    """

    def decorate(task: Callable[[DictConfig], Result]) -> Callable[[], Result | None]:
        @functools.wraps(task)
        def reporting(cfg: DictConfig) -> Result:
            warnings.formatwarning = _one_line
            keep_freed_memory()
            given = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
            try:
                own = [each for each in given if not each.startswith(_SHARED)]
                defaults = defaults_of(config_name, config_dir, given) if given else cfg
                base = defaults if own == given else defaults_of(config_name, config_dir, own)
                require_valid(cfg, defaults, given)
                require_valid_files(cfg, base, config_dir, built)
            except UserError as error:
                _fail(error, USAGE)
            try:
                return task(cfg)
            except UserError as error:
                _fail(error, _status(error, given))
            except InstantiationException as error:  # Hydra's wrapping of a constructor's exception
                if isinstance(reason := missing_extra(error) or error.__cause__, UserError):
                    named = UserError(_with_key(str(reason), str(error)))
                    _fail(named, _status(named, given))
                if reason is None:  # Hydra's own refusal
                    _fail(UserError(one_line(" ".join(str(error).split()))), USAGE)
                if not isinstance(reason, _INVALID_VALUE):
                    raise
                _fail(UserError(f"{_key(str(error))}: {reason}"), USAGE)
            except OSError as error:  # raised by a library while writing
                _fail_if_named(error, given)
                if error.errno not in NO_SPACE:
                    raise
                place = error.filename or "while writing"
                _fail(UserError(f"{place}: {error.strerror}: free some space and run the same command again"))
            except Exception as error:
                if missing := missing_extra(error):
                    _fail(missing)
                if SQLITE_NO_SPACE not in str(error):
                    raise
                _fail(UserError(f"{SQLITE_NO_SPACE}: free some space and run the same command again"))

        composed = hydra.main(version_base="1.3", config_path=str(config_dir), config_name=config_name)(reporting)

        @functools.wraps(reporting)
        def command() -> Result | None:
            sys.argv[1:] = with_scenes(with_groups(without_plus(sys.argv[1:])))
            if {"-h", "--help"} & {*sys.argv}:
                print(help_text(task.__globals__["__doc__"], config_name, config_dir, sys.argv[1:]))
                return None
            if {"-m", "--multirun"} & {*sys.argv}:  # Hydra resolves the time for each run anew; they share a folder
                os.environ.setdefault("RFPP_SWEEP", time.strftime("%Y-%m-%d_%H-%M-%S"))
            try:
                require_group_names(sys.argv[1:], config_dir)
            except UserError as error:
                _fail(error, USAGE)
            os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises its errors, and keeps tracebacks of defects
            try:
                return composed()
            except (ConfigCompositionException, OverrideParseException) as error:
                message = " ".join(f"{error} {error.__cause__ or ''}".split())
                if unknown := re.match(r"Could not override '([^']+)'", message):
                    message, similar = f"{unknown[1]}: there is no such setting", []
                    with suppress(HydraException), hydra.initialize_config_dir(str(config_dir), version_base="1.3"):
                        similar = suggestions(unknown[1], defaults_of(config_name, config_dir, sys.argv[1:]))
                    message += f": did you mean {' or '.join(similar)}?" if similar else ": see --help"
                _fail(UserError(message), USAGE)
            except OSError as error:  # raised by Hydra for its own folder
                _fail_if_named(error, sys.argv[1:])
                raise

        return command

    return decorate


def without_plus(arguments: Sequence[str]) -> list[str]:
    """Return the command line with `experiment=…` for `+experiment=…`."""
    return [given[1:] if given[:1] == "+" and given[1:].startswith(_SHARED) else given for given in arguments]


def with_groups(arguments: Sequence[str]) -> list[str]:
    """Return the command line with `a/b=name` for `a.b=name` where conf/a/b/name.yaml exists."""
    pairs = [(given, *given.partition("=")[::2]) for given in arguments]
    files = (CONFIG_DIR / key.replace(".", "/") / f"{name}.yaml" for _, key, name in pairs)
    return [
        f"{key.replace('.', '/')}={name}" if "." in key and file.is_file() else given
        for (given, key, name), file in zip(pairs, files, strict=True)
    ]


def with_scenes(arguments: Sequence[str]) -> list[str]:
    """Return the command line with `scene=…` for plain file names, as in `rfpp render chair.glb`."""
    files = [given for given in arguments if _SCENE_FILE.fullmatch(given)]
    quoted = ["'" + re.sub(r"(\\*)'", r"\1\1\'", file) + "'" for file in files]
    scene = [f"scene={quoted[0] if len(files) == 1 else '[' + ','.join(quoted) + ']'}"] if files else []
    return [given for given in arguments if given not in files] + scene


def _fail_if_named(error: OSError, given: Sequence[str]) -> None:
    """Exit if a file or folder of the command line cannot be opened or made."""
    if error.errno in _UNUSABLE and isinstance(error.filename, str) and names_path(error.filename, given):
        _fail(UserError(f"{error.filename}: {error.strerror}: choose another place"), USAGE)


def _with_key(reason: str, message: str) -> str:
    """Return a constructor's error with the key of its setting in place of the class's name; `message` is Hydra's."""
    called = re.match(r"Error in call to target '[\w.]*?(\w+)'", message)
    return re.sub(rf"^{called[1]}(?=[.:])", _key(message), reason) if called else reason


def _key(message: str) -> str:
    return message.rpartition("full_key: ")[2]


def _status(error: UserError, given: Sequence[str]) -> int:
    return USAGE if names_setting(str(error), given) else 1


def _fail(error: UserError, status: int = 1) -> NoReturn:
    print(f"error: {error}", file=sys.stderr)
    sys.exit(status)


def _one_line(message: Warning | str, category: type[Warning], *_: object) -> str:
    return f"{'warning' if category is UserWarning else category.__name__}: {message}\n"


def required(cfg: DictConfig, key: str) -> Any:
    """Return a value that only the command line gives. Raises UserError if it is missing."""
    if OmegaConf.is_missing(cfg, key):
        raise UserError(f"{key} is missing: add {key}=… to the command line")
    return cfg[key]


def settings(group: str, key: str, name: str, without: Collection[str] = ()) -> DictConfig:
    """Load conf/<group>/<name>.yaml with its defaults, for a key of the command line that holds such a name.

    Args:
        without: Names that are no choice here.

    Raises:
        UserError: If there is no such file; lists the names.
    """
    files = {file.stem: file for file in sorted((CONFIG_DIR / group).glob("*.yaml")) if file.stem not in without}
    if name not in files:
        raise UserError(f"{key}={name}: choose from {', '.join(files)}")
    chosen = OmegaConf.load(files[name])
    parents = [parent for parent in chosen.pop("defaults", ["_self_"]) if parent != "_self_"]
    return OmegaConf.merge(*(settings(group, key, parent) for parent in parents), chosen)


def write_config(cfg: Mapping[str, Any], folder: Path, name: str = "config.yaml") -> Path:
    """Write a configuration with all values resolved beside a command's output, atomically; return its path."""
    return write_atomically(folder / name, OmegaConf.to_yaml(cfg, resolve=True).encode())
