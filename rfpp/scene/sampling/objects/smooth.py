"""Smooth solids from formulas: superellipsoids, pebbles, supertoroids, metaballs."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from skimage.measure import marching_cubes

from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.objects.solid import Rng, from_manifold, grid_faces, unit_sphere


def superellipsoid(rng: Rng, faces: int) -> Mesh:
    """Draw Barr's superellipsoid: from rounded cubes over spheres and cylinders to octahedra."""
    east_west, north_south = rng.uniform(0.3, 2.0, 2)

    def radius(d: np.ndarray) -> np.ndarray:
        equator = (np.abs(d[:, 0]) ** (2 / east_west) + np.abs(d[:, 1]) ** (2 / east_west)) ** (east_west / north_south)
        return (equator + np.abs(d[:, 2]) ** (2 / north_south)) ** (-north_south / 2)

    return _radial(faces, radius)


def pebble(rng: Rng, faces: int) -> Mesh:
    """Draw a sphere displaced by a few plane waves."""
    waves = rng.integers(3, 9)
    frequency = rng.normal(size=(3, waves)) * rng.uniform(1.0, 2.5)
    phase = rng.uniform(0, 2 * np.pi, waves)
    amplitude = rng.uniform(0.2, 0.7) * rng.dirichlet(np.ones(waves))
    return _radial(faces, lambda d: 1 + np.sin(d @ frequency + phase) @ amplitude)


def supertoroid(rng: Rng, faces: int) -> Mesh:
    """Draw Barr's supertoroid: rings of round, square or diamond section."""
    tube, ring_exponent, tube_exponent = rng.uniform(0.2, 0.55), rng.uniform(0.4, 1.6), rng.uniform(0.4, 1.6)
    columns = max(3, round(math.sqrt(0.7 * faces / tube * 0.4)))
    rows = max(3, round(0.7 * faces / columns))
    u = np.arange(columns)[:, None] * 2 * np.pi / columns
    v = np.arange(rows)[None, :] * 2 * np.pi / rows
    across = 1 + tube * _signed_power(np.cos(v), tube_exponent)
    height = np.broadcast_to(tube * _signed_power(np.sin(v), tube_exponent), (columns, rows))
    x, y = (across * _signed_power(f(u), ring_exponent) for f in (np.cos, np.sin))
    index = np.arange(columns * rows).reshape(columns, rows)
    # around the ring, the tube's section runs clockwise
    triangles = grid_faces(np.concatenate([index, index[:1]]))[:, ::-1]
    return Mesh(np.stack([x, y, height], axis=-1).reshape(-1, 3), triangles)


def metaballs(rng: Rng, faces: int) -> Mesh:
    """Draw three to seven blended blobs (Blinn 1982), by marching cubes."""
    resolution = int(np.clip(math.sqrt(faces), 12, 28))
    count = int(rng.integers(3, 8))
    centers, radii = rng.uniform(-0.5, 0.5, (count, 3)), rng.uniform(0.2, 0.45, count)
    axis = np.linspace(-1.6, 1.6, resolution)
    field = np.zeros((resolution,) * 3)
    for (x, y, z), radius in zip(centers, radii, strict=True):
        gaussians = [np.exp(-(((axis - c) / radius) ** 2)) for c in (x, y, z)]
        field += np.einsum("i,j,k->ijk", *gaussians)
    vertices, triangles, _, _ = marching_cubes(field, level=0.35, gradient_direction="ascent")
    return Mesh(vertices, triangles)


def _radial(faces: int, radius: Callable[[np.ndarray], np.ndarray]) -> Mesh:
    """Return the star-shaped solid with surface distance radius(direction [V, 3]) [V] from the origin."""
    sphere = from_manifold(unit_sphere(faces))
    directions = sphere.vertices / np.linalg.norm(sphere.vertices, axis=1, keepdims=True)
    return Mesh(directions * radius(directions)[:, None], sphere.faces)


def _signed_power(x: np.ndarray, exponent: float) -> np.ndarray:
    return np.sign(x) * np.abs(x) ** exponent
