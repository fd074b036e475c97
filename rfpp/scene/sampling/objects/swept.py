"""Solids of revolution, extrusions and tubes."""

from __future__ import annotations

import math

import numpy as np
from manifold3d import CrossSection, Manifold

from rfpp.scene.mesh import Mesh
from rfpp.scene.sampling.objects.solid import Rng, from_manifold, grid_faces
from rfpp.scene.sampling.objects.space_curves import Curve, handle, knot, pipe, ring, spring


def lathe(rng: Rng, faces: int) -> Mesh:
    """Draw a solid of revolution of a smooth random profile: vases, bottles, chess pieces."""
    rings = max(5, round(math.sqrt(faces) / 2))
    height = np.linspace(-1, 1, rings)
    knots = rng.uniform(0.15, 0.9, rng.integers(3, 7))
    profile = np.interp(height, np.linspace(-1, 1, len(knots)), knots)
    if rng.random() < 0.7:  # otherwise the profile keeps its corners
        profile = np.convolve(np.pad(profile, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    outline = np.concatenate([[[0, -1]], np.stack([profile, height], axis=1), [[0, 1]]])
    segments = max(3, min(48, round(faces / (2 * rings))))
    return from_manifold(Manifold.revolve(CrossSection([outline]), circular_segments=segments))


def extrusion(rng: Rng, faces: int) -> Mesh:
    """Draw a star, polygon or gear section extruded with twist and taper: screws, columns, pyramids."""
    points = int(rng.integers(3, 9))
    inner = rng.uniform(0.45, 1.0)
    angle = np.arange(2 * points) * np.pi / points
    reach = np.where(np.arange(2 * points) % 2, inner, 1.0)
    section = np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=1)
    twist = rng.uniform(-150, 150) if rng.random() < 0.6 else 0.0
    layers = max(1, faces // (4 * points) - 1) if twist else 1  # the ends have as many faces as a layer
    top = rng.uniform(0.1, 1.0)
    solid = Manifold.extrude(CrossSection([section]), rng.uniform(0.8, 2.5), layers, twist, (top, top))
    return from_manifold(solid)


def tube(rng: Rng, faces: int) -> Mesh:
    """Draw a round, square or flat profile swept along a smooth curve: springs, knots, handles, pipes, rings."""
    sides = int(np.clip(round(math.sqrt(faces) / 3.5), 4, 10))
    stations = max(5, round(faces / (2 * sides)))
    curve = _curve(rng, stations)
    angle = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    flatness = rng.uniform(0.4, 1.0)
    profile = np.stack([np.cos(angle), flatness * np.sin(angle)], axis=1)
    width = rng.uniform(0.45, 0.85) * curve.free_radius()
    along = np.linspace(0, 1, stations)
    # open curves may taper, like horns
    widths = np.full(stations, width) if curve.closed else width * (1 - rng.uniform(0, 0.7) * along)
    normals, binormals = curve.frames(turns=int(rng.choice([0, 0, 0, 0, -1, 1])))
    offsets = profile[:, 0, None, None] * normals + profile[:, 1, None, None] * binormals  # [sides, S, 3]
    vertices = (curve.points + widths[:, None] * offsets).transpose(1, 0, 2).reshape(-1, 3)
    index = np.arange(stations * sides).reshape(stations, sides)
    if curve.closed:
        return Mesh(vertices, grid_faces(np.concatenate([index, index[:1]])))
    first, last = len(vertices), len(vertices) + 1
    start = np.stack([np.roll(index[0], -1), index[0], np.full(sides, first)], axis=1)
    end = np.stack([index[-1], np.roll(index[-1], -1), np.full(sides, last)], axis=1)
    return Mesh(np.concatenate([vertices, curve.points[[0, -1]]]), np.concatenate([grid_faces(index), start, end]))


def _curve(rng: Rng, stations: int) -> Curve:
    """Draw a curve that can be resolved with this number of stations."""
    curves = [handle, ring, pipe, *([spring] if stations >= 16 else []), *([knot] if stations >= 30 else [])]
    return curves[int(rng.integers(len(curves)))](rng, stations)
