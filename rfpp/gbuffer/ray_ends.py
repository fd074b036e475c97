"""What rays meet: the cells they end in, and what the glossy lobe of the surface there sends back along them.

Light that arrives at a cell leaves it in all directions alike; what a shiny surface mirrors does not. So a ray knows
two cells: the one it ends in, whose diffuse light it brings, and the one in which a ray ends that the glossy lobe
throws on from there (the "extended" form factors of Sillion and Puech 1989). Counted as dull, light that falls from the
floor on a rough shiny object returns to the floor; of a lobe, most of it goes on upwards.

As in the reference images, shiny surfaces are blurred in what other surfaces see of them ("Filter Glossy" of Cycles).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from rfpp.gbuffer import ggx
from rfpp.gbuffer.cells import NOWHERE, CellMap
from rfpp.gbuffer.direct_light import gathered
from rfpp.gbuffer.first_hit import facing_normals
from rfpp.gbuffer.light_sampler import LightSampler
from rfpp.gbuffer.raycast import Hits
from rfpp.gbuffer.surface import Surface, local


@dataclass(frozen=True, eq=False)
class RayEnds:
    """Where R rays end.

    Attributes:
        cell: in which cell; NOWHERE for none.
        rows: of the rays, those that end on a surface that emits nothing.
        surface: there, blurred, seen from where the rays start.
    """

    cell: Int[np.ndarray, " r"]
    rows: Int[np.ndarray, " n"]
    surface: Surface

    def onward(self, sampler: LightSampler, cells: CellMap, rng: np.random.Generator) -> Int[np.ndarray, " r"]:
        """The cell in which each ray ends that the glossy lobe throws on.

        NOWHERE in the share in which the lobe, for all that its albedo does not say, sends no light on.
        """
        surface = self.surface
        way, sent = thrown(surface, rng.random((len(surface), 2)), rng.random(len(surface)))
        found = np.full(len(self.cell), NOWHERE)
        point, way = surface.point[sent], way[sent]
        found[self.rows[sent]] = cells.of_hits(point, way, sampler.caster.cast(point, way))
        return found

    def highlights(self, sampler: LightSampler, rng: np.random.Generator) -> Float[np.ndarray, "r 3"]:
        """Radiance of the emitters that comes back along each ray by way of the glossy lobe."""
        shiny = np.flatnonzero((self.surface.specular > 0).any(-1))
        surface = self.surface.part(shiny)
        light = np.zeros((len(self.cell), 3))
        light[self.rows[shiny]] = surface.specular * gathered(sampler, surface, 1, rng)[1]
        return light


def ray_ends(
    sampler: LightSampler,
    cells: CellMap,
    origin: Float[np.ndarray, "r 3"],
    way: Float[np.ndarray, "r 3"],
    density: Float[np.ndarray, " r"],
) -> RayEnds:
    """Casts rays.

    Args:
        density: per solid angle, with which the surfaces that rays leave send them this way.
    """
    hits = sampler.caster.cast(origin, way)
    rows, surface = surface_at(sampler, origin, way, hits)
    return RayEnds(cells.of_hits(origin, way, hits), rows, blurred(surface, density[rows]))


def surface_at(
    sampler: LightSampler, origin: Float[np.ndarray, "r 3"], way: Float[np.ndarray, "r 3"], hits: Hits
) -> tuple[Int[np.ndarray, " n"], Surface]:
    """Which rays end on a surface that emits nothing, and that surface, seen from where they start.

    A ray that starts on another surface, where two touch, ends where it starts: it is not seen from anywhere.
    """
    rows = np.flatnonzero((hits.triangle >= 0) & (hits.distance > 0) & (sampler.emitter_of(hits.triangle) < 0))
    triangle, origin, way = hits.triangle[rows], origin[rows], way[rows]
    normal = facing_normals(sampler.triangles, triangle, hits.barycentric[rows], way)
    position = origin + hits.distance[rows, None] * way
    return rows, Surface.at(sampler.triangles, triangle, position, normal, origin)


def thrown(
    surface: Surface, random: Float[np.ndarray, "r 2"], threshold: Float[np.ndarray, " r"]
) -> tuple[Float[np.ndarray, "r 3"], Int[np.ndarray, " n"]]:
    """Directions that the glossy lobe throws rays in, and which rays it does throw.

    The lobe absorbs a ray in the share in which it does not send its light on, beside what its albedo says.
    """
    frame = surface.frame()
    view = local(surface.view, frame)
    incoming = ggx.sample(view, surface.alpha, random)
    density = np.maximum(ggx.pdf(view, incoming, surface.alpha), 1e-30)
    scale = ggx.multiple_scattering(view[:, 2], surface.alpha, surface.specular).mean(-1)
    sent = scale * ggx.lobe(view, incoming, surface.alpha) / density > threshold
    sent &= (surface.specular > 0).any(-1)
    return np.einsum("rk,rkx->rx", incoming, frame), np.flatnonzero(sent)


def density_of_lobes(
    surface: Surface, cosine: Float[np.ndarray, " r"], by_lobe: Float[np.ndarray, " r"]
) -> Float[np.ndarray, " r"]:
    """With which both lobes of a surface together send out a ray, per solid angle.

    Args:
        cosine: of the ray.
        by_lobe: density of the glossy lobe's own rays.
    """
    diffuse, specular = surface.diffuse.mean(-1), surface.specular.mean(-1)
    return (diffuse * cosine / np.pi + specular * by_lobe) / np.maximum(diffuse + specular, 1e-12)


def blurred(surface: Surface, density: Float[np.ndarray, " r"]) -> Surface:
    """What is seen by rays of this density: α at least √(1 - density) / 2, as "Filter Glossy" 1 of Cycles has it."""
    return replace(surface, alpha=np.maximum(surface.alpha, 0.5 * np.sqrt((1 - density).clip(0))))
