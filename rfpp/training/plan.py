"""Settings of Lightning's Trainer that follow from configuration, machine and checkpoint.

They are decided here once, before the Trainer is built, and nothing changes them afterwards.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import OmegaConf

from rfpp.errors import UserError
from rfpp.model.layers.matrix_precision import matrix_dtype

#: The precision setting that picks the fastest precision of the device.
AUTO = "auto"
#: What makes a step faster on a GPU, see `choose_acceleration`.
ACCELERATIONS = ("none", "graphs", "compiled")
#: Section of a run's config.yaml that holds its plan.
PLAN_KEY = "plan"


@dataclass(frozen=True)
class TrainingPlan:
    """Derived settings of a training run."""

    ranks: int
    precision: str
    accumulate_grad_batches: int
    val_check_interval: int

    @property
    def trainer_arguments(self) -> dict[str, Any]:
        """Arguments of Lightning's Trainer; they replace those of `conf/trainer`."""
        return {name: value for name, value in asdict(self).items() if name != "ranks"}


def require_devices(trainer: Mapping[str, Any]) -> None:
    """Raise UserError unless this machine has the GPUs that `trainer` names."""
    needed, found = _devices_per_node(trainer["devices"]), torch.cuda.device_count()
    if trainer["accelerator"] in ("gpu", "cuda") and found < needed:
        raise UserError(
            f"trainer.devices={needed}: this machine has {found} CUDA GPUs: choose another number, trainer=auto (one "
            "GPU or the CPU) or debug=cpu"
        )


def plan_training(trainer: Mapping[str, Any], precision: str, accumulation: Callable[[int], int]) -> TrainingPlan:
    """Plan a training run.

    `trainer.val_check_interval` counts optimizer steps and Lightning counts batches. A run shorter than the interval
    is validated at its end.

    Raises:
        UserError: If the number of devices is not given as a number, or the global batch does not divide among them.
    """
    ranks = trainer["num_nodes"] * _devices_per_node(trainer["devices"])
    accumulate = accumulation(ranks)
    return TrainingPlan(
        ranks=ranks,
        precision=precision,
        accumulate_grad_batches=accumulate,
        val_check_interval=min(trainer["val_check_interval"], trainer["max_steps"]) * accumulate,
    )


def choose_precision(setting: str, accelerator: str, resumed: Path | None) -> str:
    """Return the precision to train in, by Lightning's name.

    "auto" is mixed precision if the device has instructions for bfloat16 products, else float32: emulated bfloat16
    is three times slower. A resumed run keeps its precision on any machine.
    """
    before = None if resumed is None else _precision_of_run(resumed)
    if setting == AUTO:
        return before or ("bf16-mixed" if matrix_dtype(AUTO, _device(accelerator)) == torch.bfloat16 else "32-true")
    if before not in (None, setting):
        warnings.warn(
            f"{resumed}: the run was trained in {before} and continues in trainer.precision={setting}: "
            "its weights will differ from those of an uninterrupted run",
            stacklevel=2,
        )
    return setting


def choose_acceleration(setting: str, accelerator: str, precision: str, checkpointing: object) -> str:
    """Return how steps are executed: "none", "graphs" (as CUDA graphs) or "compiled" (graphs of compiled blocks).

    "auto" is "graphs" on a GPU in bfloat16. In float32, attention is planned on the host; activation checkpointing
    saves random states, which waits for the GPU.

    Raises:
        UserError: If the setting is unknown or impossible here.
    """
    if setting not in (AUTO, *ACCELERATIONS):
        raise UserError(f"accelerate={setting}: choose from {', '.join((AUTO, *ACCELERATIONS))}")
    possible = _device(accelerator).type == "cuda" and precision == "bf16-mixed" and not checkpointing
    if setting == AUTO:
        return "graphs" if possible else "none"
    if setting != "none" and not possible:
        raise UserError(
            f"accelerate={setting} needs a GPU, trainer.precision=bf16-mixed and activation_checkpointing=null: "
            "choose accelerate=auto, which does what is possible"
        )
    return setting


def _devices_per_node(devices: Any) -> int:
    count = len(devices) if isinstance(devices, Sequence) and not isinstance(devices, str) else devices
    if not isinstance(count, int) or count < 1:
        raise UserError(f"trainer.devices={devices}: give the number of devices per node")
    return count


def _precision_of_run(checkpoint: Path) -> str | None:
    """Return the precision of the run that wrote a checkpoint; None if its folder has no config.yaml."""
    config = checkpoint.parent.parent / "config.yaml"
    return OmegaConf.select(OmegaConf.load(config), f"{PLAN_KEY}.precision") if config.is_file() else None


def _device(accelerator: str) -> torch.device:
    if accelerator in ("auto", "gpu", "cuda") and torch.cuda.is_available():
        return torch.device("cuda")
    if accelerator in ("auto", "gpu", "mps") and torch.backends.mps.is_available():
        return torch.device("mps")
    return torch.device("cpu")
