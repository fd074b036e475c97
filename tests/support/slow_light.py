"""Light as NumPy would gather it, with more samples than anyone wants: the twin of the compiled loops."""

from functools import partial

import numpy as np

from rfpp.radiosity.cell_grid import CellGrid
from rfpp.radiosity.cell_table import DIRECTIONS, FLAT, SIDES
from rfpp.raycast import ggx
from rfpp.raycast.lit_scene import CLEARANCE
from rfpp.raycast.polygon_light import of_triangle
from rfpp.raycast.raycast import RayCaster
from rfpp.raycast.surface import Surface
from rfpp.raycast.vectors import tangents
from rfpp.scene.triangles import EMISSION, SceneTriangles

#: Many directions, points and triangles: a row of each function's results for each.
lobes = np.vectorize(ggx.lobe_and_pdf, signature="(3),(3),()->(),()")
samples_of = np.vectorize(lambda *drawn: np.array(ggx.sampled(*drawn)), signature="(3),(),(),()->(3)")
form_factor = np.vectorize(of_triangle, signature="(3),(3),(3,3)->()")


def multiple_scattering(cosine: np.ndarray, alpha: np.ndarray, specular: np.ndarray) -> np.ndarray:
    return np.vectorize(partial(ggx.scattered, *ggx.lobe_albedo()))(cosine, alpha, specular)


def direct_light(scene: SceneTriangles, surface: Surface, samples: int, rng: np.random.Generator) -> np.ndarray:
    """[2, R, 3] irradiance / π and glossy light, by evenly spread points on every emitting triangle."""
    caster = RayCaster(scene.positions)
    frame = np.array([[*tangents(normal), normal] for normal in surface.normal])
    found = np.zeros((2, len(surface), 3))
    view = np.einsum("rkx,rx->rk", frame, surface.view)
    scale = multiple_scattering(view[:, 2, None], surface.alpha[:, None], surface.specular)
    for emitter in np.flatnonzero(scene.is_emissive):
        a, b, c = scene.positions[emitter].astype(np.float64)
        cross = np.cross(b - a, c - a)
        for _ in range(samples):
            root, share = np.sqrt(rng.random((len(surface), 1))), rng.random((len(surface), 1))
            direction = (1 - root) * a + root * (1 - share) * b + root * share * c - surface.point
            distance = np.linalg.norm(direction, axis=-1)
            direction /= distance[:, None]
            light = np.einsum("rkx,rx->rk", frame, direction)
            clear = (caster.cast(surface.point, direction).distance >= distance - CLEARANCE) & (light[:, 2] > 0)
            solid = np.abs(direction @ cross) / 2 / distance**2 * clear / samples
            radiance = scene.material[emitter, EMISSION].astype(np.float64)
            found[0] += (solid * light[:, 2] / np.pi)[:, None] * radiance
            found[1] += (solid * lobes(view, light, surface.alpha)[0])[:, None] * radiance * scale
    return found


def cell_keys(grid: CellGrid, triangle: np.ndarray, point: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Return the keys of `CellGrid.keys`."""
    owner = grid.triangles.object_index[triangle].astype(np.int64)
    pieces, half, within = grid.pieces[owner], grid.half[owner], 0
    local = np.einsum("rij,rj->ri", grid.axes[owner], point - grid.centroid[owner])
    flat = half < FLAT * half.max(-1, keepdims=True)
    place = np.where(flat, 0, np.floor(local / np.maximum(half, 1e-9) * pieces)).astype(np.int64) + pieces
    place = np.clip(place, 0, 2 * pieces - 1)
    octant = (place >= pieces) @ np.array([1, 2, 4])
    for k in range(3):
        within = within * pieces[:, k] + place[:, k] % pieces[:, k]
    box = grid.first[owner] // (DIRECTIONS * SIDES) + octant * pieces.prod(-1) + within
    return (box * DIRECTIONS + grid._direction[triangle]) * SIDES + back
