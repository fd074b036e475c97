"""Validated settings of `launch/render.py`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator

from rfpp.errors import UserError
from rfpp.inference.scene_settings import SceneSettings, as_list
from rfpp.ranges import NonNegative, Positive
from rfpp.raycast.first_hit import CHANNELS
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Camera, Scene

#: Suffixes of `output` that make it a file instead of a folder.
_FILES = (".exr", ".png", ".mp4")


def _as_square(value: Any) -> Any:
    return (value, value) if isinstance(value, str | int) else value


def _placed(camera: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the values of a camera with its defaults; None if none is given."""
    given = {name: value for name, value in camera.items() if value is not None}
    if given and "position" not in given:
        raise ValueError("position is missing: add camera.position=[x,y,z]")
    return {"look_at": (0.0, 0.0, 0.0), "fov": 40.0, **given} if given else None


Parts = Literal["together", "separate"]


class RenderSettings(SceneSettings):
    """Settings of the same names as in conf/render/render.yaml. Raises UserError naming an invalid one."""

    scene: Annotated[tuple[Path, ...], BeforeValidator(as_list), Field(min_length=1)]
    resolution: Annotated[tuple[Positive, Positive] | None, BeforeValidator(_as_square)]
    cameras: Annotated[tuple[NonNegative, ...] | None, BeforeValidator(as_list)]
    camera: Annotated[Camera | None, BeforeValidator(_placed)]
    layers: Annotated[tuple[str, ...], BeforeValidator(as_list)]
    lights: Parts
    bounces: Parts
    fps: Annotated[float, Field(gt=0, le=1000)]
    reference: bool
    reference_settings: str

    @field_validator("scene")
    @classmethod
    def _has_distinct_names(cls, scene: tuple[Path, ...]) -> tuple[Path, ...]:
        stem, count = Counter(path.stem for path in scene).most_common(1)[0]
        if count > 1:
            raise ValueError(f"{count} scenes are called '{stem}', as their pictures would be: render each separately")
        return scene

    @field_validator("layers")
    @classmethod
    def _exist(cls, layers: tuple[str, ...]) -> tuple[str, ...]:
        if unknown := [name for name in layers if name not in CHANNELS]:
            raise ValueError(f"'{unknown[0]}' does not exist: choose from {', '.join(CHANNELS)}")
        if len(set(layers)) < len(layers):
            raise ValueError(f"{list(layers)} repeats a name: give each once")
        return layers

    def load(self, scene: Path) -> Scene | PackedScene:
        """Load one of the scenes; `camera` replaces its cameras."""
        loaded = super().load(scene)
        if self.camera is None:
            return loaded
        if isinstance(loaded, PackedScene):
            return loaded.seen_by([self.camera])
        return loaded.model_copy(update={"cameras": (self.camera,)})

    def single_camera(self) -> int:
        """Return the camera of an animation; the first by default. Raises UserError if there are several."""
        cameras = self.cameras or (0,)
        if len(cameras) > 1:
            raise UserError(f"cameras={list(cameras)}: an animation has one camera: choose one of them")
        return cameras[0]

    def stills(self, scene: Path, views: int) -> list[Path]:
        """Return an EXR file per view: `output` itself for a single one, otherwise numbered."""
        target = self._file(".exr")
        if target and views == 1:
            return [target]
        named = target or self.output / f"{scene.stem}.exr"
        return [named.with_name(f"{named.stem}_{view}.exr") for view in range(views)]

    def video(self, scene: Path, motion: str) -> Path:
        """Return an MP4 file: `output` itself, or named after the scene and the motion."""
        return self._file(".mp4") or self.output / f"{scene.stem}_{motion}.mp4"

    def _file(self, suffix: str) -> Path | None:
        """Return `output` if it names a file, None for a folder. Raises UserError if it does not fit."""
        if self.output.suffix not in _FILES:
            return None
        if self.output.suffix != suffix:
            raise UserError(f"output={self.output}: give a folder, or a file that ends in {suffix}")
        if len(self.scene) > 1:
            raise UserError(f"output={self.output}: one file for {len(self.scene)} scenes: give a folder")
        return self.output
