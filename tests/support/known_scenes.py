"""Small scenes, built corner by corner, whose pictures are known beforehand."""

import numpy as np
import trimesh

from rfpp.scene.camera import camera_to_world
from rfpp.scene.spec import Camera
from rfpp.scene.triangles import SceneTriangles

#: The light of RenderFormer's data, around the origin.
LIGHT = np.array([[[-0.025, 0.025, 0.025], [0.025, -0.025, 0.025], [0.025, 0.025, -0.025]]])


def material(diffuse=0.0, specular=0.0, roughness=0.5, emission=0.0) -> np.ndarray:
    """One row of `SceneTriangles.material`; grays may be given as one number."""
    return np.concatenate(
        [np.broadcast_to(v, n) for v, n in ((diffuse, 3), (specular, 3), (roughness, 1), (emission, 3))]
    )


def pack(*objects: tuple[np.ndarray, np.ndarray]) -> SceneTriangles:
    """Flat-shaded objects: pairs of corners [F, 3, 3] and material [10] or [F, 10]."""
    positions = np.concatenate([corners for corners, _ in objects])
    normals = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    sizes = [len(corners) for corners, _ in objects]
    return SceneTriangles(
        positions=positions.astype(np.float32),
        normals=np.repeat(normals[:, None], 3, axis=1).astype(np.float32),
        material=np.concatenate([np.broadcast_to(m, (len(c), 10)) for c, m in objects]).astype(np.float32),
        object_offsets=np.cumsum([0, *sizes]).astype(np.int32),
        object_names=tuple(f"object_{i}" for i in range(len(objects))),
    )


def look_at(position, target=(0.0, 0.0, 0.0), up=(0.0, 0.0, 1.0)) -> np.ndarray:
    """[4, 4] pose."""
    return camera_to_world(Camera(position=tuple(position), look_at=tuple(target), up=tuple(up), fov=45))


def square(size=1.0, z=0.0) -> np.ndarray:
    """A horizontal square facing up, two triangles."""
    a, b, c, d = size / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return np.add([[a, b, c], [a, c, d]], (0, 0, z))


def box(size, center=(0, 0, 0)) -> np.ndarray:
    return trimesh.creation.box(np.broadcast_to(size, 3)).triangles + np.asarray(center)


def sphere(radius, center=(0, 0, 0), subdivisions=3) -> np.ndarray:
    return trimesh.creation.icosphere(subdivisions, radius=radius).triangles + np.asarray(center)


def still_life(seed=0) -> SceneTriangles:
    """A floor, a shiny ball, a box with a color per triangle and two lights."""
    colors = np.random.default_rng(seed).uniform(0, 0.8, (12, 3))
    painted = np.stack([material(diffuse=color, specular=0.1) for color in colors])
    return pack(
        (square(), material(diffuse=0.7)),
        (sphere(0.15, (-0.2, 0, 0.15)), material(diffuse=(0.6, 0.1, 0.1), specular=0.2, roughness=0.3)),
        (box(0.2, (0.2, 0.1, 0.1)), painted),
        (LIGHT * 2.5 + [0.5, -0.5, 2.0], material(diffuse=1.0, emission=2500.0)),
        (LIGHT * 2.5 + [-1.0, -0.5, 1.8], material(diffuse=1.0, emission=2500.0)),
    )


def rigid_motion() -> np.ndarray:
    """A rotation about all axes and a translation, [4, 4]."""
    return look_at((0.3, -0.2, 0.5), (1.1, 0.6, -0.4), (0.2, 0.3, 1.0)).astype(np.float64)


def moved(triangles: SceneTriangles, motion: np.ndarray) -> SceneTriangles:
    """The scene after a rigid motion [4, 4]."""
    rotation, translation = motion[:3, :3], motion[:3, 3]
    return SceneTriangles(
        positions=(triangles.positions @ rotation.T + translation).astype(np.float32),
        normals=(triangles.normals @ rotation.T).astype(np.float32),
        material=triangles.material,
        object_offsets=triangles.object_offsets,
        object_names=triangles.object_names,
    )
