"""Describe a run: code version, settings and machine."""

from __future__ import annotations

import os
import platform
import socket
import subprocess
from pathlib import Path
from typing import Any

import torch

from rfpp.folders import is_installed

#: Tags of the variables that Slurm sets in a job.
SLURM_TAGS = {"SLURM_JOB_ID": "slurm_job_id", "SLURM_ARRAY_TASK_ID": "slurm_array_task_id"}


def flattened(config: dict[str, Any], prefix: str = "") -> dict[str, str]:
    """Flatten nested settings: {"a": {"b": 1}} → {"a.b": "1"}."""
    flat: dict[str, str] = {}
    for key, value in config.items():
        if isinstance(value, dict) and value:
            flat |= flattened(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = str(value)
    return flat


def parameters(config: dict[str, Any]) -> dict[str, str]:
    """Flatten a configuration without names and places of the run, in which any two runs differ."""
    own = [config[name] for name in ("run_dir", "run_name") if name in config]
    return {
        name: value
        for name, value in flattened(config).items()
        if not name.startswith("logger.") and not any(each in value for each in own)
    }


def machine_tags() -> dict[str, str]:
    """Return the host name, and the Slurm job if there is one."""
    jobs = {tag: os.environ[variable] for variable, tag in SLURM_TAGS.items() if variable in os.environ}
    return {"host": socket.gethostname(), **jobs}


def hardware(device: torch.device) -> str:
    """Return the name of a device, e.g. "NVIDIA A100-SXM4-80GB" or "AMD EPYC, 2 cores"."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    return f"{_processor()}, {os.cpu_count()} cores"


def _processor() -> str:
    """Return the processor's name from the kernel; Python's platform module often has only the architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def code_version() -> str | None:
    """Return the commit of this checkout, with `-dirty` if files differ from it; None outside a repository.

    RFPP_COMMIT overrides it, for copies without a repository such as containers.
    """
    if given := os.environ.get("RFPP_COMMIT"):
        return given
    described = _git("describe", "--always", "--dirty", "--abbrev=12", "--exclude=*")
    return None if described is None else described.strip()


def code_changes() -> str:
    """Return the checkout's uncommitted changes as a patch; empty if there are none."""
    return _git("diff", "HEAD", "--binary") or ""


def _git(*arguments: str) -> str | None:
    """Run git in this checkout and return its output; None outside a repository, or in an installed package."""
    if is_installed():
        return None
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=Path(__file__).parent, capture_output=True, encoding="utf-8", check=True
        )
    except (OSError, subprocess.CalledProcessError, UnicodeDecodeError):
        return None
    return done.stdout
