"""What every file in launch/ shares: Hydra composition, and one line instead of a traceback for user errors."""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import hydra
from omegaconf import DictConfig, OmegaConf

from rfpp.errors import UserError

Result = TypeVar("Result")

#: Hydra's primary configurations and groups.
CONFIG_DIR = Path(__file__).resolve().parents[1] / "conf"


def entry_point(config_name: str) -> Callable[[Callable[[DictConfig], Result]], Callable[[], Result]]:
    """Decorate `task(cfg)` into a command that composes `conf/<config_name>.yaml` and the command line.

    A `UserError` is printed as one line on stderr and the process exits with status 1. The undecorated task
    stays available as `command.__wrapped__` for callers that have composed a config themselves.
    """

    def decorate(task: Callable[[DictConfig], Result]) -> Callable[[], Result]:
        @functools.wraps(task)
        def reporting(cfg: DictConfig) -> Result:
            warnings.formatwarning = _one_line
            try:
                return task(cfg)
            except UserError as error:
                print(f"error: {error}", file=sys.stderr)
                sys.exit(1)

        return hydra.main(version_base="1.3", config_path=str(CONFIG_DIR), config_name=config_name)(reporting)

    return decorate


def _one_line(message: Warning | str, category: type[Warning], *_: object) -> str:
    return f"{'warning' if category is UserWarning else category.__name__}: {message}\n"


def required(cfg: DictConfig, key: str) -> str:
    """A value that only the command line can give. Raises UserError when it is missing."""
    if OmegaConf.is_missing(cfg, key):
        raise UserError(f"{key} is not given: add {key}=… to the command line")
    return cfg[key]
