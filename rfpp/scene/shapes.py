"""Where object meshes come from: procedural solids of nine kinds, each closed and reduced to a triangle count."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold
from skimage.measure import marching_cubes

from rfpp.errors import SceneError
from rfpp.scene.mesh import Mesh, decimated, normalized
from rfpp.scene.refinement import is_closed, refined

Rng = np.random.Generator
#: A generator of one kind draws a closed solid with very roughly the given number of faces.
Solid = Callable[[Rng, int], Mesh]


@dataclass(frozen=True)
class ProceduralShapes:
    """An endless source of closed solids.

    Attributes:
        kinds: names from `KINDS` to choose from, with equal probability.
        attempts: how many solids are drawn before a sphere, which always works, takes their place.
    """

    kinds: Sequence[str]
    attempts: int = 8

    def __post_init__(self) -> None:
        if not self.kinds:
            raise SceneError(f"ProceduralShapes.kinds: the list is empty: choose from {', '.join(KINDS)}")
        for kind in self.kinds:
            if kind not in KINDS:
                raise SceneError(f"ProceduralShapes.kinds: unknown kind '{kind}': choose from {', '.join(KINDS)}")
        object.__setattr__(self, "kinds", tuple(self.kinds))

    def sample(self, rng: Rng, target_faces: int) -> Mesh:
        """A closed mesh of `target_faces` faces (one below if that is odd, as a closed mesh has an even number).

        It is normalised: vertex mean at the origin, farthest vertex at radius 0.5. Raises SceneError if
        `target_faces` is below 12.
        """
        if target_faces < 12:
            raise SceneError(f"{target_faces} triangles are too few for a procedural shape: ask for 12 or more")
        for _ in range(self.attempts):
            solid = KINDS[self.kinds[int(rng.integers(len(self.kinds)))]]
            mesh = _stretched(rng, solid(rng, target_faces))
            try:
                mesh = normalized(_with_face_count(mesh, target_faces))
            except SceneError:  # a rare solid cannot be reduced so far
                continue
            if len(mesh) == target_faces - target_faces % 2 and _is_solid(mesh):
                return mesh
        return normalized(_with_face_count(_from_manifold(_sphere(target_faces)), target_faces))


def _with_face_count(mesh: Mesh, target_faces: int) -> Mesh:
    """The mesh with `target_faces` faces or hardly fewer: decimated from above, refined from below."""
    return refined(decimated(mesh, target_faces), target_faces)


def _is_solid(mesh: Mesh) -> bool:
    """Closed, facing outwards, and no thinner anywhere than a sheet: it fills some of its bounding box."""
    corners = mesh.corners.astype(np.float64)
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    return is_closed(mesh) and bool(volume > 0.03 * np.prod(np.ptp(mesh.vertices, axis=0)))


def _stretched(rng: Rng, mesh: Mesh) -> Mesh:
    """Half of all solids are scaled along the axes, so that no kind comes in one proportion only."""
    factors = rng.uniform(0.5, 1.0, 3) if rng.random() < 0.5 else np.ones(3)
    return Mesh(mesh.vertices * factors, mesh.faces)


def _from_manifold(solid: Manifold) -> Mesh:
    mesh = solid.to_mesh()
    return Mesh(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts))


def _sphere(faces: int) -> Manifold:
    """A unit sphere from a refined octahedron, with 1 to 1.5 times as many faces as asked for."""
    return Manifold.sphere(1.0, 4 * math.ceil(math.sqrt(1.2 * faces / 8)))


def _radial(faces: int, radius: Callable[[np.ndarray], np.ndarray]) -> Mesh:
    """The star-shaped solid whose surface lies at distance radius(direction [V, 3]) [V] from the origin."""
    sphere = _from_manifold(_sphere(faces))
    directions = sphere.vertices / np.linalg.norm(sphere.vertices, axis=1, keepdims=True)
    return Mesh(directions * radius(directions)[:, None], sphere.faces)


def superellipsoid(rng: Rng, faces: int) -> Mesh:
    """Barr's superellipsoid: from rounded cubes over spheres and cylinders to octahedra."""
    east_west, north_south = rng.uniform(0.3, 2.0, 2)

    def radius(d: np.ndarray) -> np.ndarray:
        equator = (np.abs(d[:, 0]) ** (2 / east_west) + np.abs(d[:, 1]) ** (2 / east_west)) ** (east_west / north_south)
        return (equator + np.abs(d[:, 2]) ** (2 / north_south)) ** (-north_south / 2)

    return _radial(faces, radius)


def pebble(rng: Rng, faces: int) -> Mesh:
    """A sphere displaced by a few plane waves: pebbles, potatoes, asteroids."""
    waves = rng.integers(3, 9)
    frequency = rng.normal(size=(3, waves)) * rng.uniform(1.0, 2.5)
    phase = rng.uniform(0, 2 * np.pi, waves)
    amplitude = rng.uniform(0.2, 0.7) * rng.dirichlet(np.ones(waves))
    return _radial(faces, lambda d: 1 + np.sin(d @ frequency + phase) @ amplitude)


def _signed_power(x: np.ndarray, exponent: float) -> np.ndarray:
    return np.sign(x) * np.abs(x) ** exponent


def supertoroid(rng: Rng, faces: int) -> Mesh:
    """Barr's supertoroid: rings of round, square or diamond section."""
    tube, ring_exponent, tube_exponent = rng.uniform(0.2, 0.55), rng.uniform(0.4, 1.6), rng.uniform(0.4, 1.6)
    columns = max(3, round(math.sqrt(0.7 * faces / tube * 0.4)))
    rows = max(3, round(0.7 * faces / columns))
    u = np.arange(columns)[:, None] * 2 * np.pi / columns
    v = np.arange(rows)[None, :] * 2 * np.pi / rows
    across = 1 + tube * _signed_power(np.cos(v), tube_exponent)
    height = np.broadcast_to(tube * _signed_power(np.sin(v), tube_exponent), (columns, rows))
    x, y = (across * _signed_power(f(u), ring_exponent) for f in (np.cos, np.sin))
    index = np.arange(columns * rows).reshape(columns, rows)
    right, above = np.roll(index, -1, axis=0), np.roll(index, -1, axis=1)
    diagonal = np.roll(right, -1, axis=1)
    quads = np.stack([index, right, diagonal, above], axis=-1).reshape(-1, 4)
    return Mesh(np.stack([x, y, height], axis=-1).reshape(-1, 3), quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3))


def lathe(rng: Rng, faces: int) -> Mesh:
    """A smooth random profile turned about an axis: vases, bottles, chess pieces, spinning tops."""
    rings = max(5, round(math.sqrt(faces) / 2))
    height = np.linspace(-1, 1, rings)
    knots = rng.uniform(0.15, 0.9, rng.integers(3, 7))
    profile = np.interp(height, np.linspace(-1, 1, len(knots)), knots)
    if rng.random() < 0.7:  # otherwise the corners of the profile stay
        profile = np.convolve(np.pad(profile, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    outline = np.concatenate([[[0, -1]], np.stack([profile, height], axis=1), [[0, 1]]])
    segments = max(3, min(48, round(faces / (2 * rings))))
    return _from_manifold(Manifold.revolve(CrossSection([outline]), circular_segments=segments))


def extrusion(rng: Rng, faces: int) -> Mesh:
    """A star, polygon or gear section swept upwards with twist and taper: screws, columns, pyramids."""
    points = int(rng.integers(3, 9))
    inner = rng.uniform(0.45, 1.0)
    angle = np.arange(2 * points) * np.pi / points
    reach = np.where(np.arange(2 * points) % 2, inner, 1.0)
    section = np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=1)
    twist = rng.uniform(-150, 150) if rng.random() < 0.6 else 0.0
    layers = max(1, round(faces / (4 * points))) if twist else 1
    top = rng.uniform(0.1, 1.0)
    solid = Manifold.extrude(CrossSection([section]), rng.uniform(0.8, 2.5), layers, twist, (top, top))
    return _from_manifold(solid)


def metaballs(rng: Rng, faces: int) -> Mesh:
    """Three to seven blobs melted together (Blinn 1982), by marching cubes."""
    resolution = int(np.clip(math.sqrt(faces), 12, 28))
    count = int(rng.integers(3, 8))
    centres, radii = rng.uniform(-0.5, 0.5, (count, 3)), rng.uniform(0.2, 0.45, count)
    axis = np.linspace(-1.6, 1.6, resolution)
    field = np.zeros((resolution,) * 3)
    for (x, y, z), radius in zip(centres, radii, strict=True):
        gaussians = [np.exp(-(((axis - c) / radius) ** 2)) for c in (x, y, z)]
        field += np.einsum("i,j,k->ijk", *gaussians)
    vertices, triangles, _, _ = marching_cubes(field, level=0.35, gradient_direction="ascent")
    return Mesh(vertices, triangles)


def _part(rng: Rng, segments: int) -> Manifold:
    """A box, ball, cylinder or cone of about unit size, turned and moved a little: the bricks of `carved`."""
    kind = rng.integers(4)
    if kind == 0:
        part = Manifold.cube(tuple(rng.uniform(0.5, 1.4, 3)), center=True)
    elif kind == 1:
        part = Manifold.sphere(rng.uniform(0.4, 0.75), segments)
    else:
        top = -1.0 if kind == 2 else rng.uniform(0.05, 0.4)
        part = Manifold.cylinder(rng.uniform(0.6, 1.8), rng.uniform(0.2, 0.6), top, segments, center=True)
    return part.rotate(tuple(rng.uniform(-180, 180, 3))).translate(tuple(rng.uniform(-0.35, 0.35, 3)))


def carved(rng: Rng, faces: int) -> Mesh:
    """Constructive solid geometry: two to four parts united, subtracted or intersected."""
    segments = int(np.clip(math.sqrt(2 * faces), 8, 32))
    solid = _part(rng, segments)
    for _ in range(rng.integers(1, 4)):
        part = _part(rng, segments)
        combined = [solid + part, solid - part, solid ^ part][int(rng.choice(3, p=[0.45, 0.4, 0.15]))]
        solid = combined if combined.volume() > 0.05 else solid
    return _from_manifold(max(solid.decompose(), key=lambda piece: piece.volume()))


def primitive(rng: Rng, faces: int) -> Mesh:
    """Boxes, chamfered boxes, prisms, cylinders, frusta, cones and spheres."""
    kind = rng.integers(4)
    if kind == 0:
        solid = Manifold.cube(tuple(rng.uniform(0.3, 1.0, 3)), center=True)
    elif kind == 1:
        size, bevel = rng.uniform(0.4, 1.0, 3), rng.uniform(0.03, 0.15)
        shrunk = (size - 2 * bevel * (1 - row) for row in np.eye(3))
        solid = Manifold.batch_hull([Manifold.cube(tuple(s), center=True) for s in shrunk])
    elif kind == 2:
        segments = int(rng.choice([3, 4, 5, 6, 8, 12, 24]))
        top = rng.choice([-1.0, 0.0, rng.uniform(0.1, 0.9)])
        solid = Manifold.cylinder(rng.uniform(0.5, 2.5), 0.5 * rng.uniform(0.6, 1.6), top, segments, center=True)
    else:
        solid = _sphere(faces)
    return _from_manifold(solid)


def crystal(rng: Rng, faces: int) -> Mesh:
    """The convex hull of a few points on a sphere: cut stones."""
    points = rng.normal(size=(int(rng.integers(8, 25)), 3))
    return _from_manifold(Manifold.hull_points(points / np.linalg.norm(points, axis=1, keepdims=True)))


#: Every kind of solid by name, in the order in which documentation and tests list them.
KINDS: dict[str, Solid] = {
    solid.__name__: solid
    for solid in (
        superellipsoid,
        pebble,
        supertoroid,
        lathe,
        extrusion,
        metaballs,
        carved,
        primitive,
        crystal,
    )
}
