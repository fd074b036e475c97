"""Keyframes: objects and lights that move and change."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated

from pydantic import Field

from rfpp.errors import SceneError
from rfpp.inference.motion.frames import Frames, KeyedMotion, Load, frames_between, with_cameras
from rfpp.inference.motion.interpolation import Curve, bounded, flowing, turning
from rfpp.inference.motion.key_files import (
    CameraTrack,
    Entries,
    Time,
    increasing_times,
    located,
    made_keys,
    read_keys,
)
from rfpp.scene.io.loading import load_scene
from rfpp.scene.packed import PackedScene, poses
from rfpp.scene.spec import Material, Radiance, Reflectance, Scene, SceneObject, Strict, Transform, Vector
from rfpp.scene.triangles import SceneTriangles


class Keyframes(KeyedMotion):
    """Objects of the scene, lights among them, through the keys of a file; what the file does not name stays.

        objects:
          ball:
            - {time: 0, translation: [-0.3, 0, 0.2], rotation: [0, 0, 0]}
            - {time: 2, translation: [0.3, 0, 0.2], rotation: [0, 0, 170], roughness: 0.1}
          lamp:
            - {time: 0, emissive: [3000, 3000, 3000]}
            - {time: 1, emissive: [500, 500, 500]}
        camera:                 # if it moves too; otherwise the scene's
          - {time: 0, position: [0, -2, 0.6], look_at: [0, 0, 0], fov: 40}

    Keys hold parts of an object's `transform` and `material` by the names of scene files. Each part runs through those
    keys that name it, and keeps the first one's value before and the last one's after: translations along splines,
    rotations by slerp, everything else without leaving the values of its keys.
    """

    def frames_of(self, scene: Path, camera: int, load: Load = load_scene) -> Frames:
        content = read_keys(self.file, _KeyframeFile)
        still = load(scene)
        if not isinstance(still, Scene):
            raise SceneError(f"{scene}: holds triangles but no objects to move: give any other format than H5")
        with located(f"{self.file}"):
            tracks = _tracks(content.objects, still)
        view = CameraTrack(content.camera, f"{self.file}: camera") if content.camera else None
        times = [time for track in [*tracks.values(), *filter(None, [view])] for time in track.times]
        first, last = min(times), max(times)
        fixed = None if view else with_cameras(still, scene, [camera])

        @lru_cache(maxsize=1)
        def triangles(objects: tuple[SceneObject, ...]) -> SceneTriangles:
            return SceneTriangles.from_scene(still.model_copy(update={"objects": objects}))

        def at(number: int) -> PackedScene:
            time = first + number / self.fps
            objects = tuple(tracks[o.name].at(time) if o.name in tracks else o for o in still.objects)
            c2w, fov = poses([view.at(time)]) if view else (fixed.c2w, fixed.fov)
            return PackedScene(still.name, triangles(objects), c2w, fov)

        return Frames(frames_between(first, last, self.fps), at)


class _ObjectKey(Strict):
    """Parts of an object at a time in seconds."""

    noun = ""

    time: Time
    translation: Vector | None = None
    rotation: Vector | None = None
    scale: Vector | None = None
    diffuse: Reflectance | None = None
    specular: Reflectance | None = None
    roughness: Annotated[float, Field(ge=0, le=1)] | None = None
    emissive: Radiance | None = None


class _KeyframeFile(Strict):
    noun = ""

    objects: Annotated[dict[str, Entries], Field(min_length=1)]
    camera: Entries = ()


#: How each part of an object goes from key to key; all others stay within those of their keys.
_KINDS = {"translation": flowing, "rotation": turning}


@dataclass(frozen=True)
class _Track:
    """An object whose named parts are functions of time."""

    item: SceneObject
    times: Sequence[float]
    curves: Mapping[str, Curve]

    def at(self, time: float) -> SceneObject:
        values = {name: curve(time).tolist() for name, curve in self.curves.items()}
        transform = {k: v for k, v in values.items() if k in Transform.model_fields}
        material = {k: v for k, v in values.items() if k in Material.model_fields}
        changed = {
            "transform": Transform(**{**self.item.transform.model_dump(), **transform}),
            "material": Material(**{**self.item.material.model_dump(), **material}),
        }
        return self.item.model_copy(update=changed)


def _tracks(objects: Mapping[str, Entries], scene: Scene) -> dict[str, _Track]:
    there = {item.name: item for item in scene.objects}
    tracks = {}
    for name, entries in objects.items():
        with located(f"objects.{name}"):
            if name not in there:
                raise SceneError(f"the scene has no such object: it has {reprlib.repr(list(there))[1:-1]}")
            keys = made_keys(_ObjectKey, entries)
            times, curves = increasing_times(keys), {}
            for part in _ObjectKey.model_fields.keys() - {"time"}:
                stated = [key for key in keys if getattr(key, part) is not None]
                if stated:
                    kind = _KINDS.get(part, bounded)
                    curves[part] = kind([key.time for key in stated], [getattr(key, part) for key in stated])
            track = tracks[name] = _Track(there[name], times, curves)
            for time in times:  # checks what only a whole object can violate, such as energy conservation
                SceneObject(**dict(track.at(time)))
    return tracks
