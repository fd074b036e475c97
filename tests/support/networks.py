"""Networks small enough for a test, from the project's own configuration."""

from functools import cache

import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import OmegaConf

from rfpp.checkpoint.loading import CheckpointInfo
from rfpp.commands import CONFIG_DIR
from rfpp.model.renderformer_pp import RenderFormerPP

SMALLEST = (
    "size.width=54", "size.heads=1", "size.hidden=64", "size.frequencies=3", "size.encoder_layers=1",
    "size.head_level_channels=[8,8,16,16]", "size.head_channels=16",
)  # fmt: skip


@cache
def model_config(*overrides: str) -> dict:
    """The resolved `model` config of an experiment with overrides."""
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        cfg = compose("train", overrides=[*SMALLEST, "run_dir=unused", *overrides])
    return OmegaConf.to_container(cfg.model, resolve=True)


def network(*overrides: str, seed: int = 0) -> RenderFormerPP:
    """An untrained network in evaluation mode, the same for the same seed.

    Its weights are larger than those of a fresh one, so that every input shows clearly in the image.
    """
    torch.manual_seed(seed)
    net = instantiate(model_config(*overrides), _convert_="all").eval()
    for part in net.modules():
        if isinstance(part, torch.nn.Linear):
            torch.nn.init.normal_(part.weight, std=1.5 * part.in_features**-0.5)
    return net


def checkpoint_info(model: dict | None = None, resolution=(16, 16), **changes) -> CheckpointInfo:
    """Return the description of a checkpoint."""
    about = {"data_manifest": "hash", "dataset": "small", "method": "RenderFormer++", "seed": 0, "steps": 10}
    return CheckpointInfo(model or model_config(), resolution, **about | changes)
