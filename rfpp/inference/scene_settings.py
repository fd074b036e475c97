"""Validated settings of commands that render scene files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, field_validator

from rfpp.inference.devices import available_device
from rfpp.ranges import NonNegative, Positive
from rfpp.scene.io.backdrop import Backdrop
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Scene, Strict

Settings = TypeVar("Settings", bound="LoadSettings")


def as_list(value: Any) -> Any:
    """Return a list for one name or number."""
    return [value] if isinstance(value, str | int) else value


class LoadSettings(Strict):
    """Settings of `load_scene`. Raises UserError naming an invalid one."""

    triangles: Positive | None
    detail: NonNegative
    up: Literal["y", "z"] | None
    transparent: Literal["opaque", "drop", "refuse"]
    backdrop: Backdrop

    @classmethod
    def parse(cls: type[Settings], values: Mapping[str, Any]) -> Settings:
        """Select and validate the settings in a configuration."""
        return cls(**{name: values[name] for name in cls.model_fields})

    def load(self, scene: Path) -> Scene | PackedScene:
        """Load a scene file."""
        return load_scene(scene, **self.model_dump(include=set(LoadSettings.model_fields)))


class SceneSettings(LoadSettings):
    """Settings of the same names as in conf/render. Raises UserError naming an invalid one."""

    output: Path
    exposure: Annotated[float, Field(ge=-64, le=64)]
    light_samples: Positive
    supersampling: Positive
    transports: Annotated[int, Field(ge=0, le=1024)] | None
    device: str | None

    @field_validator("device")
    @classmethod
    def _is_available(cls, device: str | None) -> str | None:
        available_device(device)
        return device

    @property
    def sampling(self) -> dict[str, int | None]:
        """Arguments of `Renderer.render` by name."""
        return self.model_dump(include={"light_samples", "supersampling", "transports"})
