"""What `launch/render.py` is asked for, checked before anything is loaded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from pydantic import BeforeValidator, Field, field_validator

from rfpp.errors import UserError
from rfpp.inference.layers import checked_layers
from rfpp.scene.io.backdrop import Backdrop
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Scene, Strict


def _listed(value: Any) -> Any:
    """A list of one thing may be given as the thing."""
    return [value] if isinstance(value, str | int) else value


def _square(value: Any) -> Any:
    return (value, value) if isinstance(value, str | int) else value


#: What `output` may end in where it is no folder; which of them depends on what is rendered.
_FILES = (".exr", ".png", ".mp4")

Positive = Annotated[int, Field(ge=1)]
Index = Annotated[int, Field(ge=0)]


class Request(Strict):
    """Values of the command line by their names there. Raises SceneError or UserError naming a wrong one.

    Attributes:
        scene: files or folders, each once, of different names: pictures are called after them.
        output: a folder, or the path of the EXR or MP4 file of a single scene.
        resolution: (height, width), or None for the network's.
        cameras: numbers, or None for all.
        triangles, up, transparent, backdrop: of `load_scene`.
        layers: G-buffer channels for the EXR.
        exposure: stops.
        light_samples: shadow rays per light and pixel, and rays per pixel into reflections.
        supersampling: samples along each side of a pixel.
        lights, bounces: whether those of a scene, or of its light, stand in layers of their own, too.
        transports: how often light is passed on in the scene, or None as in training.
        fps: of films.
        reference, reference_settings: whether Cycles renders too, and by which file of conf/reference.
        device: of torch, or None to choose.
    """

    scene: Annotated[tuple[Path, ...], BeforeValidator(_listed), Field(min_length=1)]
    output: Path
    resolution: Annotated[tuple[Positive, Positive] | None, BeforeValidator(_square)]
    cameras: Annotated[tuple[Index, ...] | None, BeforeValidator(_listed)]
    triangles: Positive | None
    up: Literal["y", "z"] | None
    transparent: Literal["opaque", "drop", "refuse"]
    backdrop: Backdrop
    layers: Annotated[tuple[str, ...], BeforeValidator(_listed)]
    exposure: Annotated[float, Field(ge=-64, le=64)]
    light_samples: Positive
    supersampling: Positive
    lights: Literal["together", "separate"]
    bounces: Literal["together", "separate"]
    transports: Annotated[int, Field(ge=0, le=1024)] | None
    fps: Annotated[float, Field(gt=0, le=1000)]
    reference: bool
    reference_settings: str
    device: str | None

    @field_validator("scene")
    @classmethod
    def _has_a_name_each(cls, scene: tuple[Path, ...]) -> tuple[Path, ...]:
        stem, times = Counter(path.stem for path in scene).most_common(1)[0]
        if times > 1:
            raise ValueError(f"pictures are called after the scene, and {times} are called '{stem}': render each alone")
        return scene

    @field_validator("layers")
    @classmethod
    def _exist(cls, layers: tuple[str, ...]) -> tuple[str, ...]:
        return checked_layers(layers)

    @field_validator("device")
    @classmethod
    def _is_there(cls, device: str | None) -> str | None:
        try:
            torch.zeros(1, device=device or "cpu")
        except (RuntimeError, AssertionError, NotImplementedError) as error:
            reason = str(error).splitlines()[0]
            raise UserError(f"device={device}: cannot be used ({reason}): give cpu, or null to choose") from None
        return device

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Request:
        """From a configuration that holds these values among others."""
        return cls(**{name: values[name] for name in cls.model_fields})

    def load(self, scene: Path) -> Scene | PackedScene:
        """One of the scenes."""
        how = {name: getattr(self, name) for name in ("triangles", "up", "transparent", "backdrop")}
        return load_scene(scene, **how)

    @property
    def sampling(self) -> dict[str, int | None]:
        """Of `Renderer.render`, by name."""
        names = ("light_samples", "supersampling", "transports")
        return {name: getattr(self, name) for name in names}

    def one_camera(self) -> int:
        """For a film; the first if none was asked for. Raises UserError for several."""
        cameras = self.cameras or (0,)
        if len(cameras) > 1:
            raise UserError(f"cameras={list(cameras)}: a film has one camera: name one of them")
        return cameras[0]

    def stills(self, scene: Path, views: int) -> list[Path]:
        """An EXR file for each view: `output` itself for a single one, else numbered after `output` or the scene."""
        target = self._file(".exr")
        if target and views == 1:
            return [target]
        named = target or self.output / f"{scene.stem}.exr"
        return [named.with_name(f"{named.stem}_{view}.exr") for view in range(views)]

    def film(self, scene: Path, motion: str) -> Path:
        """An MP4 file: `output` itself, or called after the scene and the motion."""
        return self._file(".mp4") or self.output / f"{scene.stem}_{motion}.mp4"

    def _file(self, suffix: str) -> Path | None:
        """`output` where it names a file, None where it is a folder. Raises UserError: another kind, several scenes."""
        if self.output.suffix not in _FILES:
            return None
        if self.output.suffix != suffix:
            raise UserError(f"output={self.output}: give a folder, or a file that ends in {suffix}")
        if len(self.scene) > 1:
            raise UserError(f"output={self.output}: is one file for {len(self.scene)} scenes: give a folder")
        return self.output
