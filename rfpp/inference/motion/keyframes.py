"""Keyframes: a camera, objects and lights that move and change."""

from __future__ import annotations

import reprlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import AfterValidator, BaseModel, Field, model_validator

from rfpp.errors import SceneError
from rfpp.inference.motion.frames import Frames, Load, Motion, with_cameras
from rfpp.inference.motion.interpolation import Curve, monotone, slerp, spline
from rfpp.scene.io.limits import read_bytes
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene, pack, poses
from rfpp.scene.spec import Camera, Radiance, Reflectance, Scene, SceneObject, Strict, Vector
from rfpp.scene.triangles import SceneTriangles

_MAX_BYTES = 1 << 20
#: Interpolation of each property; all others use `monotone`.
_CURVES = {"translation": spline, "rotation": slerp, "position": spline, "look_at": spline, "up": spline}


class _Key(BaseModel):
    model_config = Strict.model_config

    time: Annotated[float, Field(ge=0, le=86400)]


class _CameraKey(_Key):
    position: Vector
    look_at: Vector
    up: Vector = (0.0, 0.0, 1.0)
    fov: float


class _ObjectKey(_Key):
    translation: Vector | None = None
    rotation: Vector | None = None
    scale: Vector | None = None
    diffuse: Reflectance | None = None
    specular: Reflectance | None = None
    roughness: Annotated[float, Field(ge=0, le=1)] | None = None
    emissive: Radiance | None = None


def _increasing(keys: Sequence[_Key]) -> Sequence[_Key]:
    for before, after in pairwise(keys):
        if after.time <= before.time:
            raise ValueError(f"time {after.time:g} follows {before.time:g}: put the keys in order, each time once")
    return keys


Key = TypeVar("Key")
_Keys = Annotated[tuple[Key, ...], Field(min_length=1), AfterValidator(_increasing)]


class _KeyframeFile(Strict):
    objects: Mapping[str, _Keys[_ObjectKey]] = Field(default_factory=dict)
    camera: _Keys[_CameraKey] | None = None

    @model_validator(mode="after")
    def _has_keys(self) -> _KeyframeFile:
        if not self.objects and not self.camera:
            raise ValueError("names neither objects nor a camera: add one")
        return self


class Keyframes(Motion):
    """A camera, objects and lights that pass through the keys of a file; everything else is constant.

        camera:                 # omit it to use the scene's
          - {time: 0, position: [0, -2, 0.6], look_at: [0, 0, 0], fov: 40}
          - {time: 2, position: [1.5, -1.2, 0.6], look_at: [0, 0, 0], fov: 30}
        objects:
          ball:
            - {time: 0, translation: [-0.3, 0, 0.2], rotation: [0, 0, 0]}
            - {time: 2, translation: [0.3, 0, 0.2], rotation: [0, 0, 170], roughness: 0.1}
          lamp:
            - {time: 0, emissive: [3000, 3000, 3000]}
            - {time: 1, emissive: [500, 500, 500]}

    Times are in seconds. Keys hold properties of a camera, or of an object's `transform` and `material`, as in scene
    files. Each property passes through the keys that name it: positions on splines, rotations by slerp, all others
    without leaving the range of neighboring keys.
    """

    file: Path  # YAML or JSON
    fps: Annotated[float, Field(gt=0, le=1000)]

    @property
    def name(self) -> str:
        return self.file.stem

    def frames_of(self, scene: Path, camera: int, load: Load = load_scene) -> Frames:
        with _located(str(self.file)):
            keys = _KeyframeFile(**_parse(read_bytes(self.file, _MAX_BYTES)))
            view = _curves(keys.camera) if keys.camera else {}
            for key in keys.camera or ():
                _camera_at(view, key.time)  # checks it
        still = load(scene)
        if keys.objects and not isinstance(still, Scene):
            raise SceneError(f"{scene}: holds triangles but no objects to move: use a format other than H5")
        with _located(str(self.file)):
            tracks = _tracks(keys.objects, still)
        times = [key.time for track in (*keys.objects.values(), keys.camera or ()) for key in track]
        first, last = min(times), max(times)
        packed = pack(still) if view else with_cameras(still, scene, [camera])
        latest: dict[bytes, SceneTriangles] = {b"": packed.triangles}  # frames without a change share it

        def create(number: int) -> PackedScene:
            time = first + number / self.fps
            state = b"".join(curve(time).tobytes() for track in tracks.values() for curve in track.curves.values())
            if state not in latest:
                objects = tuple(tracks[o.name].at(time) if o.name in tracks else o for o in still.objects)
                latest.clear()
                latest[state] = SceneTriangles.from_scene(still.model_copy(update={"objects": objects}))
            with _located(f"{self.file}: camera, time {time:g}"):
                c2w, fov = poses([_camera_at(view, time)]) if view else (packed.c2w, packed.fov)
            return PackedScene(packed.name, latest[state], c2w, fov, None if tracks else packed.texture)

        return Frames(int((last - first) * self.fps + 1e-6) + 1, create)


@dataclass(frozen=True)
class _ObjectTrack:
    item: SceneObject
    curves: Mapping[str, Curve]

    def at(self, time: float) -> SceneObject:
        values = {name: curve(time).tolist() for name, curve in self.curves.items()}
        parts = {}
        for part in (self.item.transform, self.item.material):
            changed = {name: value for name, value in values.items() if name in type(part).model_fields}
            if changed:
                parts[part.noun] = type(part)(**dict(part) | changed)
        if "material" in parts:
            parts["face_material"] = None
        return self.item.model_copy(update=parts)


def _camera_at(curves: Mapping[str, Curve], time: float | int) -> Camera:
    return Camera(**{name: curve(time).tolist() for name, curve in curves.items()})


def _tracks(objects: Mapping[str, Sequence[_ObjectKey]], scene: Scene | PackedScene) -> dict[str, _ObjectTrack]:
    items = {item.name: item for item in scene.objects} if objects else {}
    tracks = {}
    for name, keys in objects.items():
        with _located(f"objects.{name}"):
            if name not in items:
                raise SceneError(f"the scene has no such object: it has {reprlib.repr(list(items))[1:-1]}")
            track = tracks[name] = _ObjectTrack(items[name], _curves(keys))
            for key in keys:  # constraints of whole objects, such as energy conservation
                item = track.at(key.time)
                SceneObject(**{field: getattr(item, field) for field in SceneObject.model_fields})
    return tracks


def _curves(keys: Sequence[_Key]) -> dict[str, Curve]:
    curves = {}
    for name in type(keys[0]).model_fields.keys() - {"time"}:
        stated = [(key.time, value) for key in keys if (value := getattr(key, name)) is not None]
        if stated:
            curves[name] = _CURVES.get(name, monotone)(*zip(*stated, strict=True))
    return curves


def _parse(text: bytes) -> dict[str, Any]:
    """Parse YAML or JSON, without executing or expanding anything."""
    expected = "give keyframes in YAML or JSON"
    try:
        decoded = text.decode("utf-8")
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(decoded, yaml.SafeLoader)):
            raise SceneError(f"aliases (*) are not supported: {expected} without them")
        values = yaml.safe_load(decoded)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise SceneError(f"{line}malformed YAML, {error.problem or error.context}: correct it") from None
    except (yaml.YAMLError, RecursionError, ValueError):  # invalid characters, deep nesting, a 13th month
        raise SceneError(f"malformed YAML: {expected}") from None
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise SceneError(f"not a mapping of names: {expected}")
    return values


@contextmanager
def _located(where: str) -> Iterator[None]:
    try:
        yield
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from None
