"""Smooth space curves of tubes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

Rng = np.random.Generator


@dataclass(frozen=True, eq=False)
class Curve:
    """Points along a curve.

    Attributes:
        points: [S, 3], S at least 5; a closed curve does not repeat the first.
    """

    points: np.ndarray
    closed: bool

    def tangents(self) -> np.ndarray:
        """Return unit tangents [S, 3], by central differences."""
        if self.closed:
            difference = np.roll(self.points, -1, axis=0) - np.roll(self.points, 1, axis=0)
        else:
            difference = np.gradient(self.points, axis=0)
        return difference / np.linalg.norm(difference, axis=1, keepdims=True)

    def frames(self, turns: int) -> tuple[np.ndarray, np.ndarray]:
        """Return rotation-minimizing unit normals and binormals [S, 3], with an additional even twist of `turns`.

        A closed curve is also twisted so that its ends match.
        """
        tangents = self.tangents()
        normals = np.empty_like(tangents)
        normal = np.eye(3)[np.abs(tangents[0]).argmin()]
        for i, tangent in enumerate(np.concatenate([tangents, tangents[:1]])):
            normal = normal - (normal @ tangent) * tangent
            normal = normal / np.linalg.norm(normal)
            if i < len(tangents):
                normals[i] = normal
        binormals = np.cross(tangents, normals)
        gap = np.arctan2(normal @ binormals[0], normal @ normals[0]) if self.closed else 0.0
        angle = (2 * np.pi * turns - gap) * np.arange(len(normals))[:, None] / len(normals)
        cosine, sine = np.cos(angle), np.sin(angle)
        return cosine * normals + sine * binormals, cosine * binormals - sine * normals

    def free_radius(self) -> float:
        """Return the maximum tube radius without folds at bends and contact between parts of the curve."""
        neighbors = self.points if self.closed else self.points[1:-1]
        before, after = (
            (np.roll(self.points, 1, axis=0), np.roll(self.points, -1, axis=0))
            if self.closed
            else (self.points[:-2], self.points[2:])
        )
        a, b, c = neighbors - before, after - neighbors, after - before
        lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1) * np.linalg.norm(c, axis=1)
        bend = (lengths / np.maximum(2 * np.linalg.norm(np.cross(a, b), axis=1), 1e-12)).min()  # circumradius
        return float(min(bend, 0.5 * self._nearest_pass(), 0.3 * np.ptp(self.points, axis=0).max()))

    def _nearest_pass(self) -> float:
        """Return the minimum distance between parts of the curve that are farther apart along it than twice that."""
        steps = np.linalg.norm(np.roll(self.points, -1, axis=0) - self.points, axis=1)
        position = np.concatenate([[0], np.cumsum(steps)[:-1]])
        along = np.abs(position[:, None] - position)
        if self.closed:
            along = np.minimum(along, steps.sum() - along)
        across = np.linalg.norm(self.points[:, None] - self.points, axis=2)
        return float(across[along > 1.5 * across].min(initial=np.inf))


def handle(rng: Rng, stations: int) -> Curve:
    """Draw a superelliptic arc, open by design."""
    reach = rng.uniform(0.5, 0.8) * np.pi
    angle = np.linspace(-reach, reach, stations)
    exponent = rng.uniform(0.7, 1.0)
    x, y = (np.sign(f(angle)) * np.abs(f(angle)) ** exponent for f in (np.cos, np.sin))
    return Curve(np.stack([rng.uniform(0.6, 1.6) * x, y, np.zeros(stations)], axis=1), closed=False)


def ring(rng: Rng, stations: int) -> Curve:
    """Draw a closed wavy curve."""
    angle = np.arange(stations) * 2 * np.pi / stations
    waves = int(rng.integers(2, 2 + max(1, stations // 12)))
    radius = 1 + rng.uniform(0, 0.25) * np.cos(waves * angle + rng.uniform(0, 2 * np.pi))
    height = rng.uniform(0, 0.5) * np.sin(waves * angle)
    return Curve(np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1), closed=True)


def pipe(rng: Rng, stations: int) -> Curve:
    """Draw a spline through a few points advancing along x."""
    knots = int(rng.integers(3, 4 + min(3, stations // 8)))
    points = np.stack([np.arange(knots), *rng.uniform(-0.7, 0.7, (2, knots))], axis=1)
    return Curve(CubicSpline(np.arange(knots), points)(np.linspace(0, knots - 1, stations)), closed=False)


def spring(rng: Rng, stations: int) -> Curve:
    """Draw a helix of at least eight points per turn, possibly tapered."""
    turns = rng.uniform(1.2, max(1.6, min(5.0, stations / 9)))
    angle = np.linspace(0, 2 * np.pi * turns, stations)
    radius = np.linspace(1, rng.uniform(0.5, 1.0), stations)
    pitch = rng.uniform(0.5, 0.9)
    return Curve(
        np.stack([radius * np.cos(angle), radius * np.sin(angle), pitch * angle / (2 * np.pi)], axis=1), closed=False
    )


def knot(rng: Rng, stations: int) -> Curve:
    """Draw a torus knot: a trefoil, or one with more crossings if there are enough points."""
    kinds = [(2, 3), (3, 2), *([(2, 5), (3, 4)] if stations >= 55 else [])]
    around, through = kinds[int(rng.integers(len(kinds)))]
    angle = np.arange(stations) * 2 * np.pi / stations
    tube = rng.uniform(0.35, 0.5)
    radius = 1 + tube * np.cos(through * angle)
    height = tube * np.sin(through * angle) * rng.uniform(1.0, 1.4)
    return Curve(np.stack([radius * np.cos(around * angle), radius * np.sin(around * angle), height], axis=1), True)
