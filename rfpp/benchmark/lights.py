"""What unusual lights and materials cost: a scene read and a first picture of it, beside one small light instead."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rfpp.benchmark.exhibits import SceneFile
from rfpp.benchmark.spheres import sphere
from rfpp.benchmark.textured import Textured
from rfpp.inference.renderer import Renderer
from rfpp.scene.packed import PackedScene
from rfpp.scene.triangles import DIFFUSE, EMISSION, ROUGHNESS, SPECULAR, SceneTriangles

Row = dict[str, str | int | float]
#: Edge of the one small light, and the radius of the emitters that take a scene's own ones' place.
_EDGE, _RADIUS = 0.16, 0.1


@dataclass(frozen=True)
class Relit:
    """A stored scene whose emitters are replaced by spheres around its middle, above everything.

    Attributes:
        title: what the table calls it.
        stored: the scene.
        lights, triangles: how many emitters, of so many triangles each.
    """

    title: str
    stored: SceneFile
    lights: int
    triangles: int

    def scene(self) -> PackedScene:
        scene = self.stored.scene()
        angles = np.arange(self.lights) * 2 * np.pi / self.lights
        places = np.stack([1.2 * np.cos(angles), 1.2 * np.sin(angles), np.full(self.lights, 1.6)], axis=1)
        shape = _RADIUS * sphere(self.triangles).corners
        return replace(scene, triangles=_lit_by(scene.triangles, [shape + place for place in places]))


@dataclass(frozen=True)
class Coated:
    """A stored scene with another surface on everything that does not emit.

    Attributes:
        title, stored: see `Relit`.
        mirrors: a mirror each; else a colour and a roughness for each triangle, as textures become.
    """

    title: str
    stored: SceneFile
    mirrors: bool

    def scene(self) -> PackedScene:
        scene = self.stored.scene()
        material, surface = scene.triangles.material.copy(), ~scene.triangles.is_emissive
        if self.mirrors:
            rows = np.concatenate([np.zeros(3), np.full(3, 0.9), np.zeros(1)])[None]
        else:
            rows = np.random.default_rng(0).uniform(0.05, 0.6, (surface.sum(), 7)) * ([1] * 3 + [0.1] * 3 + [1])
        for columns in (DIFFUSE, SPECULAR, ROUGHNESS):
            material[surface, columns] = rows[:, columns]
        return replace(scene, triangles=replace(scene.triangles, material=material))


def measure(
    checkpoint: str,
    scenes: Sequence[SceneFile | Relit | Coated | Textured],
    resolution: int,
    rounds: int,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """A row per scene: seconds until it is there, of a first picture, and of the same with one small light; the least
    of all rounds.

    Args:
        checkpoint: see `rfpp.checkpoint.loading.load_network`.
        resolution: pixels along each side.
        rounds: how often each is timed, by turns.
        progress: called with (scenes done, scenes in all).
    """
    _seconds(checkpoint, scenes[0].scene(), resolution)  # compiles the loops over rays
    for number, described in enumerate(scenes):
        seconds = []
        for _ in range(rounds):
            start = time.perf_counter()
            scene = described.scene()
            read = time.perf_counter() - start
            small = with_one_small_light(scene)
            seconds.append([read, *(_seconds(checkpoint, each, resolution) for each in (scene, small))])
        read, own, one = np.min(seconds, axis=0).tolist()
        yield {
            "scene": described.title,
            "triangles": len(scene.triangles),
            "lights": scene.triangles.num_lights,
            "emitting": int(scene.triangles.is_emissive.sum()),
            "resolution": resolution,
            "read_s": read,
            "first_s": own,
            "one_light_s": one,
            "ratio": own / one,
        }
        progress(number + 1, len(scenes))


def with_one_small_light(scene: PackedScene) -> PackedScene:
    """Its emitters replaced by a triangle in the middle of them; surfaces and their materials stay."""
    emitting = scene.triangles.positions[scene.triangles.is_emissive]
    corners = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]]) * _EDGE / 2
    return replace(scene, triangles=_lit_by(scene.triangles, [(emitting.mean(axis=(0, 1)) + corners)[None]]))


def _seconds(checkpoint: str, scene: PackedScene, resolution: int) -> float:
    """Of the first picture that a renderer makes."""
    renderer = Renderer.load(checkpoint)
    start = time.perf_counter()
    renderer.render(scene, resolution=resolution)
    return time.perf_counter() - start


def _lit_by(triangles: SceneTriangles, emitters: Sequence[np.ndarray]) -> SceneTriangles:
    """The surfaces of a scene, and emitters of [F, 3, 3] corners, each an object, that send out as much together."""
    surface = ~triangles.is_emissive
    power = (_areas(triangles.positions)[:, None] * triangles.material[:, EMISSION]).sum(axis=0)
    positions = np.concatenate(emitters).astype(np.float32)
    normals = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    material = np.zeros((len(positions), 10), np.float32)
    material[:, ROUGHNESS] = 1
    material[:, EMISSION] = power / _areas(positions).sum()
    sizes = np.bincount(triangles.object_index[surface], minlength=triangles.num_objects)
    kept = np.flatnonzero(sizes)
    return SceneTriangles(
        positions=np.concatenate([triangles.positions[surface], positions]),
        normals=np.concatenate([triangles.normals[surface], np.repeat(normals[:, None], 3, axis=1)]),
        material=np.concatenate([triangles.material[surface], material]),
        object_offsets=np.cumsum([0, *sizes[kept], *map(len, emitters)], dtype=np.int32),
        object_names=(
            *(triangles.object_names[number] for number in kept),
            *(f"emitter_{number}" for number in range(len(emitters))),
        ),
    )


def _areas(corners: np.ndarray) -> np.ndarray:
    """[F]."""
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
