"""Solids constructed from simpler ones: carved, bevelled, primitive, crystal."""

from __future__ import annotations

import math

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold

from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.objects.solid import Rng, from_manifold, unit_sphere

#: Beam sections as unions of grid squares: L, T, U, plus, S.
_BEAMS = (
    ((0, 0), (1, 0), (2, 0), (0, 1)),
    ((0, 0), (1, 0), (2, 0), (1, 1)),
    ((0, 0), (1, 0), (2, 0), (0, 1), (2, 1)),
    ((1, 0), (0, 1), (1, 1), (2, 1), (1, 2)),
    ((0, 0), (1, 0), (1, 1), (2, 1)),
)


def carved(rng: Rng, faces: int) -> Mesh:
    """Combine two to four parts by union, difference or intersection."""
    segments = int(np.clip(math.sqrt(2 * faces), 8, 32))
    solid = _part(rng, segments)
    for _ in range(rng.integers(1, 4)):
        part = _part(rng, segments)
        combined = [solid + part, solid - part, solid ^ part][int(rng.choice(3, p=[0.45, 0.4, 0.15]))]
        solid = combined if combined.volume() > 0.05 else solid
    return from_manifold(max(solid.decompose(), key=lambda piece: piece.volume()))


def _part(rng: Rng, segments: int) -> Manifold:
    """Draw a box, ball, cylinder or cone of about unit size, rotated and displaced."""
    kind = rng.integers(4)
    if kind == 0:
        part = Manifold.cube(tuple(rng.uniform(0.5, 1.4, 3)), center=True)
    elif kind == 1:
        part = Manifold.sphere(rng.uniform(0.4, 0.75), segments)
    else:
        top = -1.0 if kind == 2 else rng.uniform(0.05, 0.4)
        part = Manifold.cylinder(rng.uniform(0.6, 1.8), rng.uniform(0.2, 0.6), top, segments, center=True)
    return part.rotate(tuple(rng.uniform(-180, 180, 3))).translate(tuple(rng.uniform(-0.35, 0.35, 3)))


def bevelled(rng: Rng, faces: int) -> Mesh:
    """Draw boxes, prisms and frusta with chamfered or rounded edges, and beams of L, T, U, S or cross section."""
    return from_manifold(_beam(rng, faces) if rng.random() < 0.3 else _convex_with_bevel(rng, faces))


def _convex_with_bevel(rng: Rng, faces: int) -> Manifold:
    """Draw the Minkowski sum of a convex solid and an octahedron (chamfered edges) or a ball (rounded edges)."""
    corners = int(rng.choice([3, 4, 4, 4, 5, 6, 8]))
    angle = (np.arange(corners) + 0.5) * 2 * np.pi / corners
    section = np.stack([np.cos(angle), np.sin(angle)], axis=1) * rng.uniform(0.3, 1.0, 2 if corners == 4 else 1)
    top = section * (rng.uniform(0.3, 1.0) if rng.random() < 0.4 else 1.0)
    height = rng.uniform(0.15, 1.2)
    # each corner becomes a piece of the ball, so its faces count
    segments = 4 if rng.random() < 0.4 else 4 * max(1, round(math.sqrt(faces / 100)))
    ball = from_manifold(Manifold.sphere(rng.uniform(0.05, 0.3) * min(height, section.max()), segments)).vertices
    vertices = np.concatenate([np.insert(section, 2, -height, axis=1), np.insert(top, 2, height, axis=1)])
    return Manifold.hull_points((vertices[:, None] + ball).reshape(-1, 3))


def _beam(rng: Rng, faces: int) -> Manifold:
    """Draw a beam whose section has rounded outer and inner corners."""
    squares = _BEAMS[int(rng.integers(len(_BEAMS)))]
    section = CrossSection()
    for corner in squares:
        section += CrossSection.square((1.0, 1.0)).translate(corner)
    radius, segments = rng.uniform(0.08, 0.24), 4 * max(1, round(math.sqrt(faces) / 10))
    for distance in (-radius, 2 * radius, -radius):  # opening rounds outer corners, closing rounds inner ones
        section = section.offset(distance, JoinType.Round, 2.0, segments)
    return Manifold.extrude(section.simplify(0.01), rng.uniform(0.4, 5.0))


def primitive(rng: Rng, faces: int) -> Mesh:
    """Draw boxes, prisms, cylinders, frusta, cones and spheres."""
    kind = rng.integers(3)
    if kind == 0:
        solid = Manifold.cube(tuple(rng.uniform(0.3, 1.0, 3)), center=True)
    elif kind == 1:
        segments = int(rng.choice([3, 4, 5, 6, 8, 12, 24]))
        top = rng.choice([-1.0, 0.0, rng.uniform(0.1, 0.9)])
        solid = Manifold.cylinder(rng.uniform(0.5, 2.5), 0.5 * rng.uniform(0.6, 1.6), top, segments, center=True)
    else:
        solid = unit_sphere(faces)
    return from_manifold(solid)


def crystal(rng: Rng, faces: int) -> Mesh:
    """Draw the convex hull of a few points on a sphere."""
    points = rng.normal(size=(int(rng.integers(8, 25)), 3))
    return from_manifold(Manifold.hull_points(points / np.linalg.norm(points, axis=1, keepdims=True)))
