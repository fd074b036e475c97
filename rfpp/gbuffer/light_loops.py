"""The loops of the first bounce over points and their samples, between the casts of rays; see `direct_light`.

Arrays have a row for each of R points and, where it says so, a column for each of S samples; emitters are counted
within one light.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from rfpp.gbuffer.compiled import compiled
from rfpp.gbuffer.ggx import lobe_and_pdf, sampled
from rfpp.gbuffer.polygon_light import of_triangle
from rfpp.gbuffer.vectors import GOLDEN, in_frame, tangents


class Light(NamedTuple):
    """E emitting triangles, as loops read them.

    Attributes:
        corners, normals, radiance: [E, 3, 3], [E, 3], [E, 3].
        steps: [E] sums of their shares of the samples, up to each.
        density: [E] of samples, per area.
        formula: whether they are few enough for Lambert's.
    """

    corners: Float[np.ndarray, "e 3 3"]
    normals: Float[np.ndarray, "e 3"]
    radiance: Float[np.ndarray, "e 3"]
    steps: Float[np.ndarray, " e"]
    density: Float[np.ndarray, " e"]
    formula: bool


@compiled
def toward_light(points, normals, shifts, light, way, reach, density, emitter, arriving):
    """Fills in, for samples of one light: unit directions, distances, densities per solid angle, emitters, and what
    would arrive of the mean radiance with nothing in between."""
    corners, radiance, steps = light.corners, light.radiance, light.steps
    samples = way.shape[1]
    for row in range(len(points)):
        point, normal = points[row], normals[row]
        for s in range(samples):
            u = ((s + 0.5) / samples + shifts[row, 0]) % 1
            v = (s * GOLDEN % 1 + shifts[row, 1]) % 1
            e = min(np.searchsorted(steps, u, side="right"), len(steps) - 1)
            # what is left of the number within its step is uniform again
            before = steps[e - 1] if e else 0.0
            root = np.sqrt(min(max((u - before) / (steps[e] - before), 0.0), 1.0))
            to_a, to_b, to_c = 1 - root, root * (1 - v), root * v
            a, b, c = corners[e]
            x = to_a * a[0] + to_b * b[0] + to_c * c[0] - point[0]
            y = to_a * a[1] + to_b * b[1] + to_c * c[1] - point[1]
            z = to_a * a[2] + to_b * b[2] + to_c * c[2] - point[2]
            distance = np.sqrt(x * x + y * y + z * z)
            x, y, z = x / distance, y / distance, z / distance
            way[row, s, 0], way[row, s, 1], way[row, s, 2] = x, y, z
            reach[row, s], emitter[row, s] = distance, e
            density[row, s] = _density(light, e, way[row, s], distance)
            cosine = max(x * normal[0] + y * normal[1] + z * normal[2], 0.0)
            brightness = (radiance[e, 0] + radiance[e, 1] + radiance[e, 2]) / 3
            arriving[row, s] = brightness * cosine / density[row, s]


@compiled
def from_light(points, normals, views, alphas, light, way, density, emitter, arriving, in_sight, diffuse, glossy):
    """Adds what samples of one light bring; glossy light where alpha is not negative."""
    corners, radiance, samples = light.corners, light.radiance, way.shape[1]
    for row in range(len(points)):
        point, normal = points[row], normals[row]
        if light.formula:
            visible, whole = 0.0, 0.0
            for s in range(samples):
                whole += arriving[row, s]
                visible += arriving[row, s] * in_sight[row, s]
            if visible > 0:
                for e in range(len(corners)):
                    factor = of_triangle(point, normal, corners[e]) * (visible / max(whole, 1e-30))
                    for c in range(3):
                        diffuse[row, c] += radiance[e, c] * factor
        first, second = tangents(normal)
        view = in_frame(views[row], first, second, normal)
        for s in range(samples):
            if not in_sight[row, s]:
                continue
            e, toward = emitter[row, s], in_frame(way[row, s], first, second, normal)
            if not light.formula:
                for c in range(3):
                    diffuse[row, c] += max(toward[2], 0.0) / density[row, s] / (np.pi * samples) * radiance[e, c]
            if alphas[row] >= 0:
                reflected, by_lobe = lobe_and_pdf(view, toward, alphas[row])
                weight = reflected * _over_density(density[row, s], by_lobe)
                for c in range(3):
                    glossy[row, c] += weight * radiance[e, c]


@compiled
def along_lobe(normals, views, alphas, shifts, way, cosine):
    """Fills in directions that the glossy lobe samples, and their cosines."""
    samples = way.shape[1]
    for row in range(len(normals)):
        normal = normals[row]
        first, second = tangents(normal)
        view = in_frame(views[row], first, second, normal)
        for s in range(samples):
            u = ((s + 0.5) / samples + shifts[row, 0]) % 1
            v = (s * GOLDEN % 1 + shifts[row, 1]) % 1
            x, y, z = sampled(view, alphas[row], u, v)
            cosine[row, s] = z
            for k in range(3):
                way[row, s, k] = x * first[k] + y * second[k] + z * normal[k]


@compiled
def from_lobe(normals, views, alphas, rows, ways, distances, emitters, light, glossy):
    """Adds what samples of the lobe bring that have met emitters of a `Light` that is all lights of the scene.

    Args:
        rows: the point of each sample.
    """
    for n in range(len(rows)):
        row, e, way = rows[n], emitters[n], ways[n]
        normal = normals[row]
        first, second = tangents(normal)
        view = in_frame(views[row], first, second, normal)
        toward = in_frame(way, first, second, normal)
        reflected, by_lobe = lobe_and_pdf(view, toward, alphas[row])
        weight = reflected * _over_density(by_lobe, _density(light, e, way, distances[n]))
        for c in range(3):
            glossy[row, c] += weight * light.radiance[e, c]


@compiled
def _density(light, e, way, distance):
    """Per solid angle, of points spread over an emitter; infinite for one seen edge-on."""
    face = light.normals[e]
    facing = abs(way[0] * face[0] + way[1] * face[1] + way[2] * face[2])
    return light.density[e] * distance * distance / facing


@compiled
def _over_density(own, other):
    """1 / own density, times the weight of a sample that the other way of sampling could have given too.

    The power heuristic own² / (own² + other²) (Veach 1997): a sharp lobe is left to its own samples, which see the
    light whole, where light samples would hit the lobe now and then and sparkle.
    """
    return own / (own * own + other * other)
