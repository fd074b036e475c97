"""Triangles and rays to hits. The only file that knows the ray-tracing library (Embree)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.errors import MissingDependencyError


class Hits(NamedTuple):
    """The nearest hit of each of R rays; where there is none, -1, zeros and infinity.

    Attributes:
        triangle: [R] int32 index of the triangle, -1 for none.
        barycentric: [R, 3] float32 weights of the triangle's corners 0, 1, 2.
        distance: [R] float32 along the ray, in lengths of its direction.
    """

    triangle: Int[np.ndarray, " r"]
    barycentric: Float[np.ndarray, "r 3"]
    distance: Float[np.ndarray, " r"]


class RayCaster:
    """An acceleration structure over triangles, possibly none at all; built once, cast many times.

    Args:
        positions: [M, 3, 3] float32 corners.

    Raises:
        MissingDependencyError: Embree is not installed.
    """

    def __init__(self, positions: Float[np.ndarray, "m 3 3"]) -> None:
        embree_scene, embree_mesh = _embree()
        # Embree reads these vertices in place, so they live as long as the caster.
        self._positions = np.array(positions, dtype=np.float32, order="C")
        self._scene = embree_scene()
        self._mesh = embree_mesh(self._scene, self._positions) if len(self) else None
        self.cast(np.zeros((1, 3)), np.ones((1, 3)))  # the first ray builds the structure; threads may send the next

    def __len__(self) -> int:
        """The number of triangles."""
        return len(self._positions)

    def cast(self, origins: Float[np.ndarray, "r 3"], directions: Float[np.ndarray, "r 3"]) -> Hits:
        """The nearest triangle in front of each ray; both sides of a triangle count."""
        count = len(origins)
        if self._mesh is None or count == 0:
            return Hits(np.full(count, -1, np.int32), np.zeros((count, 3), np.float32), np.full(count, np.inf, "f4"))
        found = self._scene.run(_packed(origins), _packed(directions), output=True)
        triangle, u, v = found["primID"].astype(np.int32), found["u"], found["v"]
        hit = triangle >= 0
        barycentric = np.stack([1 - u - v, u, v], axis=-1) * hit[:, None]
        return Hits(triangle, barycentric.astype(np.float32), np.where(hit, found["tfar"], np.inf).astype(np.float32))

    def occluded(
        self,
        origins: Float[np.ndarray, "r 3"],
        directions: Float[np.ndarray, "r 3"],
        max_distance: Float[np.ndarray, " r"],
    ) -> Bool[np.ndarray, " r"]:
        """Whether anything lies on each ray nearer than `max_distance` (in lengths of its direction)."""
        if self._mesh is None or len(origins) == 0:
            return np.zeros(len(origins), bool)
        reach = np.ascontiguousarray(max_distance, dtype=np.float32)
        return self._scene.run(_packed(origins), _packed(directions), dists=reach, query="OCCLUDED") >= 0


def _packed(vectors: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(vectors, dtype=np.float32)


def _embree():
    """Embree's scene and mesh classes, imported late so that what needs no rays runs without them."""
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise MissingDependencyError(f"G-buffers need Embree ({error}): pip install embreex") from error
    return EmbreeScene, TriangleMesh
