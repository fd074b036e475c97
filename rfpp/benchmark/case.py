"""Synthetic scenes with a given number of triangles and objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from rfpp.batch import RaggedBatch, SceneViews
from rfpp.errors import UserError
from rfpp.ranges import Positive
from rfpp.raycast.first_hit import CHANNELS
from rfpp.scene.camera import camera_to_world
from rfpp.scene.spec import Camera
from rfpp.scene.triangles import SceneTriangles

#: Light sources per scene, at most half of its objects. Each is one triangle, as in all families of scenes.
LIGHTS = 4
#: Standard deviation of the logarithm of an object's triangle count.
_SPREAD = 0.5


@dataclass(frozen=True)
class Case:
    """Size of a batch.

    Attributes:
        triangles, objects, views: Numbers per scene; light sources count as objects.
    """

    triangles: Positive
    objects: Positive
    views: Positive
    resolution: Positive
    scenes: Positive

    def __post_init__(self) -> None:
        if not 1 <= self.objects <= self.triangles or min(self.views, self.resolution, self.scenes) < 1:
            raise UserError(f"{self}: use at least 1 everywhere, and at least as many triangles as objects")

    def batch(self, channels: Sequence[str], seed: int) -> RaggedBatch:
        """Return a batch with these G-buffer channels; images and G-buffers are noise."""
        return RaggedBatch.pack([self._scene(channels, np.random.default_rng([seed, i])) for i in range(self.scenes)])

    def _scene(self, channels: Sequence[str], rng: np.random.Generator) -> SceneViews:
        triangles = _triangles(object_sizes(self.triangles, self.objects, rng), rng)
        eyes = 1.8 * _directions(rng, self.views)
        cameras = [Camera(position=tuple(eye), look_at=(0, 0, 0), up=(0.1, 0.2, 1), fov=40) for eye in eyes.tolist()]
        c2w, fov = np.stack([camera_to_world(camera) for camera in cameras]), np.full(self.views, 40, np.float32)
        return noisy_views(triangles, c2w, fov, channels, self.resolution, rng)


def noisy_views(
    triangles: SceneTriangles,
    c2w: Float[np.ndarray, "v 4 4"],
    fov: Float[np.ndarray, " v"],
    channels: Sequence[str],
    resolution: int,
    rng: np.random.Generator,
) -> SceneViews:
    """Return a scene whose images and G-buffers are noise, for measurements where only their size matters."""
    shape = (len(fov), 3 + sum(CHANNELS[name] for name in channels), resolution, resolution)
    image, gbuffer = np.split(rng.random(shape, np.float32), [3], axis=1)
    return SceneViews("synthetic", triangles, c2w, fov, gbuffer, image)


def object_sizes(triangles: int, objects: int, rng: np.random.Generator) -> Int[np.ndarray, " objects"]:
    """Draw each object's number of triangles, as uneven as in real scenes; light sources come last."""
    lights = min(LIGHTS, objects // 2)
    shares = np.cumsum(rng.lognormal(0, _SPREAD, objects - lights))
    ends = np.round((triangles - objects) * shares / shares[-1]).astype(int)  # one triangle each is set aside
    return np.concatenate([1 + np.diff(ends, prepend=0), np.ones(lights, int)])


def _triangles(sizes: Int[np.ndarray, " objects"], rng: np.random.Generator) -> SceneTriangles:
    """Draw spheres of small triangles in the unit box, and light sources around it."""
    total, objects = int(sizes.sum()), len(sizes)
    lights = min(LIGHTS, objects // 2)
    owner = np.repeat(np.arange(objects), sizes)
    centers = np.concatenate([rng.uniform(-0.4, 0.4, (objects - lights, 3)), 2.4 * _directions(rng, lights)])
    edge = 2 / np.sqrt(sizes)[owner, None, None]  # the triangles of an object cover its sphere
    normals = _normalized(_directions(rng, total)[:, None] + edge * rng.normal(size=(total, 3, 3)))
    reflectance = np.repeat(rng.uniform(0.05, 0.5, (objects, 7)), sizes, axis=0)
    emission = np.where(owner >= objects - lights, 3000.0, 0.0)[:, None].repeat(3, axis=1)
    return SceneTriangles(
        positions=(centers[owner, None] + 0.1 * normals).astype(np.float32),
        normals=normals.astype(np.float32),
        material=np.concatenate([reflectance, emission], axis=1).astype(np.float32),
        object_offsets=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32),
        object_names=tuple(f"object {i}" for i in range(objects)),
    )


def _directions(rng: np.random.Generator, count: int) -> Float[np.ndarray, "count 3"]:
    return _normalized(rng.normal(size=(count, 3)))


def _normalized(vectors: Float[np.ndarray, "*rows 3"]) -> Float[np.ndarray, "*rows 3"]:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
