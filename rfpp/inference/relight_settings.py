"""Validated settings of `launch/relight.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from rfpp.inference.scene_settings import SceneSettings, as_list
from rfpp.ranges import NonNegative

Files = Annotated[tuple[Path, ...], BeforeValidator(as_list)]


class RelightSettings(SceneSettings):
    """Settings of the same names as in conf/render/relight.yaml. Raises UserError naming an invalid one."""

    scene: Path
    target: Annotated[Files, Field(min_length=1)]
    cameras: Annotated[tuple[NonNegative, ...] | None, BeforeValidator(as_list)]
    mask: Files | None
    colors: bool

    @model_validator(mode="after")
    def _fit(self) -> RelightSettings:
        for name, given in (("cameras", self.cameras), ("mask", self.mask)):
            if given is not None and len(given) != len(self.target):
                listed = ", ".join(map(str, given))
                raise ValueError(f"target: {len(self.target)} pictures for {name}={listed}: give one for each")
        return self
