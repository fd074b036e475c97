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

#: How Slurm calls a job, and the tag for it.
SLURM_TAGS = {"SLURM_JOB_ID": "slurm_job_id", "SLURM_ARRAY_TASK_ID": "slurm_array_task_id"}


def flattened(config: dict[str, Any], prefix: str = "") -> dict[str, str]:
    """{"a": {"b": 1}} → {"a.b": "1"}."""
    flat: dict[str, str] = {}
    for key, value in config.items():
        if isinstance(value, dict) and value:
            flat |= flattened(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = str(value)
    return flat


def machine_tags() -> dict[str, str]:
    """The host, and the Slurm job where there is one."""
    jobs = {tag: os.environ[variable] for variable, tag in SLURM_TAGS.items() if variable in os.environ}
    return {"host": socket.gethostname(), **jobs}


def hardware(device: torch.device) -> str:
    """The device in words, e.g. "NVIDIA A100-SXM4-80GB" or "AMD EPYC, 2 cores"."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    return f"{_processor()}, {os.cpu_count()} cores"


def _processor() -> str:
    """The processor's name as the kernel gives it; Python itself knows little more than the architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def code_version() -> str | None:
    """The commit of this checkout, with `-dirty` when files differ from it; None outside a repository.

    A copy that is no clone, in a container say, is told by RFPP_COMMIT.
    """
    if told := os.environ.get("RFPP_COMMIT"):
        return told
    described = _git("describe", "--always", "--dirty", "--abbrev=12", "--exclude=*")
    return None if described is None else described.strip()


def code_changes() -> str:
    """Uncommitted changes of the checkout as a patch; empty if there are none."""
    return _git("diff", "HEAD", "--binary") or ""


def _git(*arguments: str) -> str | None:
    """Output of a git command in this checkout; None outside a repository, or inside another project's."""
    if is_installed():
        return None
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=Path(__file__).parent, capture_output=True, encoding="utf-8", check=True
        )
    except (OSError, subprocess.CalledProcessError, UnicodeDecodeError):
        return None
    return done.stdout
