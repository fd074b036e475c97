"""Random triangle soups with cameras, for tests that need a scene's structure but not its looks."""

import numpy as np

from rfpp.batch import SceneViews
from rfpp.scene.camera import camera_to_world
from rfpp.scene.spec import Camera
from rfpp.scene.triangles import SceneTriangles


def random_triangles(rng: np.random.Generator, object_sizes=(12, 5, 1)) -> SceneTriangles:
    """Objects of the given triangle counts at random places; the last one is a light."""
    positions, normals, materials = [], [], []
    for o, count in enumerate(object_sizes):
        center = rng.uniform(-0.4, 0.4, 3)
        positions.append(center + rng.normal(0, 0.08, (count, 3, 3)))
        directions = rng.normal(size=(count, 3, 3))
        normals.append(directions / np.linalg.norm(directions, axis=-1, keepdims=True))
        material = np.concatenate([rng.uniform(0, 0.6, 3), [rng.uniform(0, 0.3)] * 3, rng.uniform(0.05, 1, 1), [0] * 3])
        if o == len(object_sizes) - 1:
            material[7:] = rng.uniform(1000, 4000)
        materials.append(np.tile(material, (count, 1)))
    return SceneTriangles(
        positions=np.concatenate(positions).astype(np.float32),
        normals=np.concatenate(normals).astype(np.float32),
        material=np.concatenate(materials).astype(np.float32),
        object_offsets=np.concatenate([[0], np.cumsum(object_sizes)]).astype(np.int32),
        object_names=tuple(f"object_{i}" for i in range(len(object_sizes))),
    )


def random_views(
    rng: np.random.Generator, object_sizes=(12, 5, 1), views: int = 2, resolution: int = 16, channels: int = 7
) -> SceneViews:
    """A random scene with random G-buffers and images."""
    eyes = rng.normal(size=(views, 3))
    eyes = 1.8 * eyes / np.linalg.norm(eyes, axis=1, keepdims=True)
    cameras = [Camera(position=tuple(e), look_at=(0, 0, 0), up=(0.1, 0.2, 1), fov=40) for e in eyes.tolist()]
    return SceneViews(
        key=f"random-{rng.integers(1 << 30)}",
        triangles=random_triangles(rng, object_sizes),
        c2w=np.stack([camera_to_world(c) for c in cameras]),
        fov=rng.uniform(30, 60, views).astype(np.float32),
        gbuffer=rng.uniform(0, 1, (views, channels, resolution, resolution)).astype(np.float32),
        image=rng.exponential(0.5, (views, 3, resolution, resolution)).astype(np.float32),
    )
