"""Check settings against the annotations of the constructors that receive them, or against those in this module."""

from __future__ import annotations

import inspect
import math
import re
from dataclasses import is_dataclass
from pkgutil import resolve_name
from typing import Annotated, Any, Literal, get_type_hints

from omegaconf import DictConfig, OmegaConf
from pydantic import AfterValidator, ConfigDict, Field, PydanticUserError, TypeAdapter, ValidationError

from rfpp.ranges import NonNegative, Positive, Share


def _text(pattern: str, expected: str) -> Any:
    """Return the type of text that begins with a pattern; `expected` is the message for other text."""

    def matching(value: str) -> str:
        if not re.match(pattern, value):
            raise ValueError(expected)
        return value

    return Annotated[str, AfterValidator(matching)]


_ADDRESS = _text(
    "databricks|[a-z][a-z0-9+.-]*:", "an address was expected, such as http://server:5000 or sqlite:///runs.db"
)
_METRIC = _text("validation/", "a validation metric was expected, such as validation/log_l1")
#: Types of settings that are no argument of a constructor, or one of Lightning's with a wider annotation.
_TYPES = {
    "accelerate": Literal["auto", "none", "graphs", "compiled"],
    "action": str,
    "against": str | None,
    "callbacks.best.mode": Literal["min", "max"],
    "callbacks.best.monitor": _METRIC | None,
    "callbacks.divergence.factor": Annotated[float, Field(gt=0)],
    "checkpoint": str | Annotated[list[str], Field(min_length=1)] | None,
    "data.splits": dict[str, NonNegative],
    "datamodule.augmentation.color": dict[Literal["_target_"], str] | None,
    "datamodule.source.root": str | Annotated[list[str], Field(min_length=1)],
    "device": str | None,
    "evaluation.ablation_scenes": NonNegative,
    "evaluation.baseline_scenes": Positive,
    "evaluation.bootstrap.resamples": Positive,
    "evaluation.bootstrap.seed": NonNegative,
    "evaluation.detailed": bool,
    "evaluation.lpips": bool,
    "evaluation.splits": Annotated[list[str], Field(min_length=1)],
    "format": Literal["renderformer", "h5", "exr"],
    "h5.folder": str | None,
    "h5.test": Share,
    "h5.validation": Share,
    "initial_weights": str | None,
    "mask": str | list[str] | None,
    "logger.tracking_uri": _ADDRESS | None,
    "max_megabytes": Annotated[float, Field(gt=0, le=1e6)],
    "method": str,
    "mlflow_experiment": str,
    "moving_seconds": Annotated[float, Field(gt=0, le=60)],
    "name": str,
    "optimizer.lr": Annotated[float, Field(gt=0)],
    "output": str | None,
    "port": Annotated[int, Field(ge=0, le=65535)],
    "preview": NonNegative,
    "refining.default_resolution": Positive,
    "refining.images_per_step": Positive,
    "refining.initial": str | None,
    "refining.method": str,
    "refining.samplings": Annotated[list[tuple[Positive, Positive]], Field(min_length=1)],
    "refining.scenes": Positive | None,
    "refining.steps": Positive,
    "refining.validate_every_n_steps": Positive,
    "registry.folder": str,
    "registry.tracking_uri": _ADDRESS | None,
    "resolution": Positive | tuple[Positive, Positive] | None,
    "roll_backs": NonNegative,
    "run_dir": str,
    "run_name": str,
    "sample": str | None,
    "scene": str | list[str],
    "seed": Annotated[int, Field(ge=0, lt=2**32)],
    "size.cross_layers": Positive,
    "size.decoder_layers": Positive,
    "size.encoder_layers": Positive,
    "size.encoder_layers_before_transport": Positive,
    "size.frequencies": Positive,
    "size.head_channels": Positive,
    "size.head_level_channels": Annotated[list[Positive], Field(min_length=1)],
    "size.heads": Positive,
    "size.hidden": Positive,
    "size.name": str,
    "size.transport_layers": Positive,
    "size.unconstrained_layers": Positive,
    "size.width": Positive,
    "slice.count": Positive,
    "slice.index": NonNegative,
    "steps": Positive,
    "target": str | list[str],
    "trainer.accelerator": Literal["auto", "cpu", "gpu", "cuda", "mps"],
    "trainer.check_val_every_n_epoch": Positive | None,
    "trainer.devices": Positive | Literal["auto", -1] | Annotated[list[NonNegative], Field(min_length=1)],
    "trainer.log_every_n_steps": Positive,
    "trainer.max_steps": Positive,
    "trainer.num_nodes": Positive,
    "trainer.val_check_interval": Positive,
    "variant": str,
}


def declared_problem(cfg: DictConfig, key: str, before: Any) -> str | None:
    """Return why `key` cannot have its value in `cfg`; None if it can, or if no type is declared for it.

    Args:
        cfg: Composed configuration; a node with `_target_` names a constructor, and its other keys are arguments.
        key: Name of a setting, with dots.
        before: Its default; infinity and NaN are refused unless the default is one of them.
    """
    declared = _TYPES.get(key, _annotation(cfg, key))
    value = OmegaConf.select(cfg, key, throw_on_resolution_failure=False)
    if declared is None or (isinstance(value, DictConfig) and "_target_" in value):
        return None
    if OmegaConf.is_config(value):
        value = OmegaConf.to_container(value)
    infinite = isinstance(before, float) and not math.isfinite(before)
    settings = ConfigDict(arbitrary_types_allowed=True, allow_inf_nan=infinite)
    try:
        taken = TypeAdapter(declared, config=settings).validate_python(value)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        if all(problem["type"] == "literal_error" for problem in problems):
            choices = ", ".join(problem["ctx"]["expected"] for problem in problems)
            return f"choose from {choices.replace(' or ', ', ')}"
        message = problems[0]["msg"].removeprefix("Value error, ")
        return f"{message[0].lower()}{message[1:]}"
    except (PydanticUserError, NameError):  # no type that pydantic knows
        return None
    if isinstance(taken, int | float) and type(taken) is not type(value) and isinstance(value, bool | str):
        return "a number was expected"
    return None


def _annotation(cfg: DictConfig, key: str) -> Any:
    if not is_argument(cfg, key):
        return None
    parent, _, name = key.rpartition(".")
    try:
        constructor = resolve_name(OmegaConf.select(cfg, parent)["_target_"])
        has_fields = is_dataclass(constructor) or hasattr(constructor, "model_fields")
        annotated = constructor.__init__ if inspect.isclass(constructor) and not has_fields else constructor
        return get_type_hints(annotated, include_extras=True).get(name)
    except (ImportError, AttributeError, NameError, TypeError, ValueError):  # instantiation reports it
        return None


def is_argument(cfg: DictConfig, key: str) -> bool:
    """Return whether the setting `key` of `cfg` is an argument of a constructor."""
    parent = key.rpartition(".")[0]
    node = OmegaConf.select(cfg, parent) if parent else None
    return isinstance(node, DictConfig) and isinstance(node.get("_target_"), str)
