"""The presets of conf/reference, as commands read them."""

from typing import Any

from omegaconf import OmegaConf

from rfpp.commands import settings


def preset(name: str) -> dict[str, Any]:
    """Return the arguments of `CyclesSettings`."""
    values = OmegaConf.to_container(settings("reference", "reference_settings", name))
    assert values.pop("_target_") == "rfpp.reference.cycles.CyclesSettings"
    return values
