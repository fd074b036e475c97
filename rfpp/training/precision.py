"""The precision of a training run."""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
from omegaconf import OmegaConf

from rfpp.model.layers.matrix_precision import matrix_dtype

#: A setting that stands for whatever suits the device.
AUTO = "auto"


def training_precision(chosen: str, accelerator: str, resumed: Path | None) -> str:
    """The precision to train in, by Lightning's name.

    "auto" is mixed precision where the device multiplies in bfloat16, as in rendering, and float32 elsewhere: emulated,
    bfloat16 takes three times as long. A run that goes on keeps what it was begun in, on whatever machine.

    Args:
        chosen: "auto", or a name of Lightning's, which wins.
        accelerator: Lightning's setting.
        resumed: the checkpoint to go on from.
    """
    before = None if resumed is None else _begun_in(resumed)
    if chosen == AUTO:
        return before or ("bf16-mixed" if matrix_dtype(AUTO, _device(accelerator)) == torch.bfloat16 else "32-true")
    if before not in (None, chosen):
        warnings.warn(
            f"{resumed}: trained in {before} until here, goes on in trainer.precision={chosen}: "
            "it will not end with the bits of a run that was never stopped",
            stacklevel=2,
        )
    return chosen


def _begun_in(checkpoint: Path) -> str | None:
    """The precision setting of a checkpoint's run; None if its folder does not state it."""
    config = checkpoint.parent.parent / "config.yaml"
    return OmegaConf.select(OmegaConf.load(config), "trainer.precision") if config.is_file() else None


def _device(accelerator: str) -> torch.device:
    """The device that Lightning will use."""
    if accelerator in ("auto", "gpu", "cuda") and torch.cuda.is_available():
        return torch.device("cuda")
    if accelerator in ("auto", "gpu", "mps") and torch.backends.mps.is_available():
        return torch.device("mps")
    return torch.device("cpu")
