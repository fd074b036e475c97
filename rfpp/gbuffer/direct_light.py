"""The first bounce: light that reaches what a camera sees straight from the emitters, shadows included.

The term T L_e of the rendering equation's series L = L_e + T L_e + T² L_e + …, at every pixel's first hit. It needs
no more than the G-buffer does: the scene, its lights and a ray caster.

Diffuse: Lambert's exact formula for each emitting triangle, times the share of it that is in sight, which shadow rays
estimate; so fully visible light carries no noise. Glossy: light samples (the same shadow rays) and lobe samples
combined by multiple importance sampling, which serves mirrors under small lights and dull surfaces under large ones
alike, with the lobe itself and no fitted approximation of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float

from rfpp.gbuffer import ggx
from rfpp.gbuffer.first_hit import DirectLight, GBuffer, camera_positions
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.polygon_light import form_factor
from rfpp.scene.triangles import DIFFUSE, ROUGHNESS, SPECULAR, SceneTriangles

#: Pairs of a point and a sample (or an emitting triangle) worked on at a time, which bounds the memory.
_CHUNK = 1 << 18
#: Shadow rays start and end this far from surfaces, in world units (a scene's edge is 1).
_CLEARANCE = 1e-4


@dataclass(frozen=True, eq=False)
class _Surface:
    """R first hits: where shadow rays start, shading normal, direction to the camera, material."""

    point: Float[np.ndarray, "r 3"]
    normal: Float[np.ndarray, "r 3"]
    view: Float[np.ndarray, "r 3"]
    alpha: Float[np.ndarray, " r"]
    specular: Float[np.ndarray, "r 3"]

    def part(self, rows: slice) -> _Surface:
        return _Surface(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


def with_direct_light(
    gbuffer: GBuffer,
    c2w: Float[np.ndarray, "4 4"],
    fov: SupportsFloat,
    sampler: LightSampler,
    samples: int,
    seed: int = 0,
) -> GBuffer:
    """The same G-buffer with the direct light at its hits.

    Args:
        gbuffer: of the sampler's scene.
        c2w, fov: of its camera, as in `rfpp.gbuffer.first_hit.first_hit`.
        samples: shadow rays per light and pixel, and as many in all for the glossy lobe. Where no shadow's edge runs,
            diffuse light is exact with any number.
        seed: of the samples' displacement from pixel to pixel; the same seed gives the same numbers.
    """
    turn = c2w[:3, :3].astype(np.float64)
    position = camera_positions(gbuffer.depth, fov)[gbuffer.hit] @ turn.T + c2w[:3, 3]
    normal = gbuffer.normal[gbuffer.hit] @ turn.T
    surface = _surface(sampler.triangles, gbuffer.triangle[gbuffer.hit], position, normal, c2w[:3, 3])
    count, lights = len(position), sampler.lights
    shifts = np.random.default_rng(seed).random((count, lights + 1, 2))
    maps = np.zeros((2, *gbuffer.depth.shape, 3), np.float32)
    if lights:
        rows = _chunks(count, max(samples, len(sampler.corners)))
        parts = [_gather(sampler, surface.part(r), shifts[r], samples) for r in rows]
        maps[:, gbuffer.hit] = np.concatenate(parts, axis=1)
    return replace(gbuffer, light=DirectLight(*maps))


def direct_radiance(gbuffer: GBuffer, material: Float[np.ndarray, "m 10"]) -> Float[np.ndarray, "h w 3"]:
    """Outgoing radiance of the direct light in a G-buffer that holds it: diffuse plus glossy.

    Args:
        material: [M, 10] of the same triangles (`SceneTriangles.material`).
    """
    seen = material[gbuffer.triangle] * gbuffer.hit[..., None]
    return gbuffer.light.diffuse * seen[..., DIFFUSE] + gbuffer.light.glossy * seen[..., SPECULAR]


def _gather(
    sampler: LightSampler, surface: _Surface, shifts: Float[np.ndarray, "r lights_plus_1 2"], samples: int
) -> Float[np.ndarray, "2 r 3"]:
    """Diffuse and glossy light at every point."""
    unshadowed = form_factor(surface.point, surface.normal, sampler.corners)
    frame = _frame(surface.normal)
    view = _local(surface.view, frame)
    shines = (surface.specular > 0).any(-1) & (view[:, 2] > 0)
    diffuse, glossy = np.zeros((2, *surface.point.shape))
    for light in range(sampler.lights):
        target, emitter = sampler.points(light, _lattice(samples, shifts[:, light]))
        way = target - surface.point[:, None]
        distance = np.linalg.norm(way, axis=-1)
        way /= distance[..., None]
        density = sampler.density(emitter, way, distance)
        local = _local(way, frame)
        arriving = sampler.radiance[emitter].mean(-1) * local[..., 2].clip(0) / density
        in_sight = arriving > 0
        rows = np.nonzero(in_sight)[0]
        reach = distance[in_sight] - _CLEARANCE
        in_sight[in_sight] = ~sampler.caster.occluded(surface.point[rows], way[in_sight], reach)

        mine = sampler.light == light
        visible = (arriving * in_sight).sum(1) / np.maximum(arriving.sum(1), 1e-30)
        diffuse += (unshadowed[:, mine] @ sampler.radiance[mine]) * visible[:, None]

        used = in_sight & shines[:, None]
        rows = np.nonzero(used)[0]
        reflected, by_lobe = _lobe(view[rows], local[used], surface.alpha[rows])
        weight = reflected * _over_density(density[used], by_lobe)
        np.add.at(glossy, rows, weight[:, None] * sampler.radiance[emitter[used]])

    rows = np.repeat(np.flatnonzero(shines), samples)
    local = ggx.sample(view[rows], surface.alpha[rows], _lattice(samples, shifts[shines, -1]).reshape(-1, 2))
    way = np.einsum("rk,rkx->rx", local, frame[rows])
    hits = sampler.caster.cast(surface.point[rows], way)
    emitter = sampler.emitter_of(hits.triangle)
    used = (emitter >= 0) & (local[:, 2] > 0)
    rows, emitter = rows[used], emitter[used]
    reflected, by_lobe = _lobe(view[rows], local[used], surface.alpha[rows])
    by_light = sampler.density(emitter, way[used], hits.distance[used].astype(np.float64))
    np.add.at(glossy, rows, (reflected * _over_density(by_lobe, by_light))[:, None] * sampler.radiance[emitter])

    glossy *= ggx.multiple_scattering(view[:, 2], surface.alpha, surface.specular) / samples
    return np.stack([diffuse, glossy])


def _lobe(
    view: Float[np.ndarray, "n 3"], light: Float[np.ndarray, "n 3"], alpha: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """What the glossy lobe reflects from each direction, and the density of its own samples there."""
    return ggx.lobe(view, light, alpha), ggx.pdf(view, light, alpha)


def _over_density(own: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """1 / own density, times the weight of a sample that the other way of sampling could have given too.

    The power heuristic own² / (own² + other²) (Veach 1997): a sharp lobe is left to its own samples, which see the
    light whole, where light samples would hit the lobe now and then and sparkle.
    """
    return own / (own**2 + other**2)


def _surface(
    triangles: SceneTriangles, triangle: np.ndarray, position: np.ndarray, normal: np.ndarray, camera: np.ndarray
) -> _Surface:
    view = camera - position
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    corners = triangles.positions[triangle].astype(np.float64)
    geometric = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    geometric /= np.linalg.norm(geometric, axis=-1, keepdims=True)
    geometric *= np.where((geometric * view).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    material = triangles.material[triangle].astype(np.float64)
    return _Surface(
        point=position + _CLEARANCE * geometric,
        normal=normal,
        view=view,
        alpha=np.maximum(material[:, ROUGHNESS][:, 0] ** 2, ggx.MIN_ALPHA),
        specular=material[:, SPECULAR],
    )


def _lattice(samples: int, shift: Float[np.ndarray, "r 2"]) -> Float[np.ndarray, "r s 2"]:
    """Well-spread points of the unit square, displaced per row (Cranley and Patterson 1976)."""
    count = np.arange(samples)
    spread = np.stack([(count + 0.5) / samples, count * 0.6180339887498949 % 1], axis=-1)
    return (spread + shift[:, None]) % 1


def _frame(normal: Float[np.ndarray, "r 3"]) -> Float[np.ndarray, "r 3 3"]:
    """Rows: two tangents and the normal (Duff et al., "Building an Orthonormal Basis, Revisited", 2017)."""
    x, y, z = normal.T
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    first = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    second = np.stack([b, sign + y * y * a, -y], axis=-1)
    return np.stack([first, second, normal], axis=1)


def _local(vectors: Float[np.ndarray, "r *s 3"], frame: Float[np.ndarray, "r 3 3"]) -> Float[np.ndarray, "r *s 3"]:
    return np.einsum("r...x,rkx->r...k", vectors, frame)


def _chunks(count: int, width: int) -> Iterator[slice]:
    step = max(1, _CHUNK // width)
    return (slice(start, start + step) for start in range(0, count, step))
