"""A scene for compiled loops: triangles to cast rays at, their materials, and emitters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from rfpp.raycast import ggx
from rfpp.raycast.compiled import compiled, float64
from rfpp.raycast.embree import closest
from rfpp.raycast.texel_lookup import texel_at
from rfpp.raycast.vectors import Triple, Vector, added, dot, normal_of, scaled, triple, unit

#: Rays start and end this far from surfaces, in world units (a scene's edge is 1).
CLEARANCE = 1e-4


class LitScene(NamedTuple):
    """M triangles, of which E emit, in L lights.

    Attributes:
        address: Address of the acceleration structure (`rfpp.raycast.embree`).
        positions, normals, material: Arrays of `SceneTriangles`.
        texel_level, first_texel, texels: Arrays of `rfpp.scene.texels.Texels`; without any, all levels are 0.
        emitter: Index of each triangle's emitter, -1 for others.
        corners, radiance: Emitters, light by light.
        facing: Their unit normals; those of solid lights point outwards.
        one_sided: True if the emitter shines on its front alone, the side of its facing.
        area: Area.
        share: Share of its light's power.
        steps: Cumulative sums of the shares within each light.
        first: Offsets of each light's emitters.
        shining: True if the light is on.
        exact: True if Lambert's formula holds: few triangles, equally bright, and parallel or solid.
        middle, reach: Center and radius of a sphere around each light.
        solid: True for few triangles that bound a convex body; a point sees the sides that face it.
        albedo, mean_albedo: Tables of `rfpp.raycast.ggx.lobe_albedo`.
    """

    address: int
    positions: Float[np.ndarray, "m 3 3"]
    normals: Float[np.ndarray, "m 3 3"]
    material: Float[np.ndarray, "m 10"]
    texel_level: Int[np.ndarray, " m"]
    first_texel: Int[np.ndarray, " m"]
    texels: Float[np.ndarray, "t 10"]
    emitter: Int[np.ndarray, " m"]
    corners: Float[np.ndarray, "e 3 3"]
    facing: Float[np.ndarray, "e 3"]
    radiance: Float[np.ndarray, "e 3"]
    steps: Float[np.ndarray, " e"]
    one_sided: Bool[np.ndarray, " e"]
    area: Float[np.ndarray, " e"]
    share: Float[np.ndarray, " e"]
    first: Int[np.ndarray, " l_plus_1"]
    shining: Bool[np.ndarray, " l"]
    exact: Bool[np.ndarray, " l"]
    solid: Bool[np.ndarray, " l"]
    middle: Float[np.ndarray, "l 3"]
    reach: Float[np.ndarray, " l"]
    albedo: Float[np.ndarray, "table table"]
    mean_albedo: Float[np.ndarray, " table"]


@compiled
def light_of(scene: LitScene, emitter: int) -> int:
    """Return the light that an emitter belongs to."""
    light = 0
    while scene.first[light + 1] <= emitter:
        light += 1
    return light


@compiled
def intersect(scene: LitScene, origin: Vector, direction: Vector) -> tuple[int, float, float, float, Triple]:
    """Return a ray's closest hit: triangle (-1 for none), weights of its corners 1 and 2, distance, and the point."""
    triangle, u, v, distance = closest(scene.address, origin, direction)
    return triangle, u, v, distance, added(origin, scaled(direction, distance if triangle >= 0 else 0.0))


@compiled
def surface_at(
    scene: LitScene, triangle: int, u: float, v: float, direction: Vector, point: Vector
) -> tuple[Triple, Triple, Triple]:
    """Return the surface at a ray's hit: origin of further rays, shading normal on the ray's side, direction back."""
    corners = scene.positions[triangle]
    a, b, c = triple(corners[0]), triple(corners[1]), triple(corners[2])
    face = unit(*normal_of(a, b, c))
    corners = scene.normals[triangle]
    a, b, c = triple(corners[0]), triple(corners[1]), triple(corners[2])
    w = 1 - u - v
    normal = unit(w * a[0] + u * b[0] + v * c[0], w * a[1] + u * b[1] + v * c[1], w * a[2] + u * b[2] + v * c[2])
    side = -1.0 if dot(face, direction) > 0 else 1.0
    return added(point, scaled(face, side * CLEARANCE)), scaled(normal, side), scaled(direction, -1.0)


@compiled
def scattering(scene: LitScene, cosine: float, alpha: float, specular: float) -> float:
    """Return the factor of `rfpp.raycast.ggx.scattered` for one surface and color."""
    return ggx.scattered(scene.albedo, scene.mean_albedo, cosine, alpha, specular)


@compiled
def tinted(scene: LitScene, glossy: Vector, cosine: float, alpha: float, specular: Vector) -> Triple:
    """Return glossy light with multiple scattering, from that of single scattering."""
    return (
        glossy[0] * scattering(scene, cosine, alpha, specular[0]),
        glossy[1] * scattering(scene, cosine, alpha, specular[1]),
        glossy[2] * scattering(scene, cosine, alpha, specular[2]),
    )


@compiled
def growth(scene: LitScene, cosine: float, alpha: float, specular: Vector) -> Triple:
    """Return `rfpp.raycast.ggx.scattering_growth` for each color."""
    return (
        ggx.scattering_growth(scene.albedo, scene.mean_albedo, cosine, alpha, specular[0]),
        ggx.scattering_growth(scene.albedo, scene.mean_albedo, cosine, alpha, specular[1]),
        ggx.scattering_growth(scene.albedo, scene.mean_albedo, cosine, alpha, specular[2]),
    )


@compiled
def slope_of(scene: LitScene, glossy: Vector, cosine: float, alpha: float, specular: Vector) -> Triple:
    """Return the derivative of specular albedo · glossy light by that albedo, including multiple scattering."""
    more = growth(scene, cosine, alpha, specular)
    return (
        glossy[0] * (1 + specular[0] * more[0]),
        glossy[1] * (1 + specular[1] * more[1]),
        glossy[2] * (1 + specular[2] * more[2]),
    )


@compiled
def texel_hit(scene: LitScene, triangle: int, u: float, v: float, footprint: float) -> int:
    """Return the row of the texel at a ray's hit, -1 for the triangle's own material; see `texel_at`."""
    if scene.texel_level[triangle] == 0:
        return -1
    corners = scene.positions[triangle]
    across = normal_of(triple(corners[0]), triple(corners[1]), triple(corners[2]))
    area = np.sqrt(dot(across, across)) / 2
    return texel_at(scene.texel_level, scene.first_texel, triangle, u, v, area, footprint)


@compiled
def alpha_of(scene: LitScene, triangle: int) -> float:
    """Return α of a triangle's glossy lobe."""
    roughness = float64(scene.material[triangle, 6])
    return max(roughness * roughness, ggx.MIN_ALPHA)


@compiled
def blurred(alpha: float, density: float) -> float:
    """Return α of a surface hit by rays of this density per solid angle: at least √(1 - density) / 4.

    Few rays find a small highlight, which leaves blotches. Blurring it, as in Cycles' Filter Glossy, gives light from
    every ray; twice this blur loses 2% more of the light of a scene with a mirror.
    """
    spread: float = np.sqrt(max(1 - density, 0.0))
    return max(alpha, 0.25 * spread)


@compiled
def density_of_lobes(diffuse: float, specular: float, cosine: float, by_lobe: float) -> float:
    """Return the density per solid angle with which both lobes together draw a ray.

    Args:
        diffuse, specular: Mean albedos.
        cosine: Cosine between the ray and the normal.
        by_lobe: Density of the glossy lobe's own rays.
    """
    return (diffuse * cosine / np.pi + specular * by_lobe) / max(diffuse + specular, 1e-12)
