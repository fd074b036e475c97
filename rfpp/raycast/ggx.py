"""The glossy lobe of our materials: GGX with height-correlated Smith shadowing and energy-preserving scaling.

No Fresnel term; the specular albedo colors the lobe, as in Cycles' "Multiscatter GGX". All vectors are unit vectors in
the frame of the shading normal, with z along it; α is the square of the roughness.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float

from rfpp.raycast.compiled import compiled
from rfpp.raycast.vectors import GOLDEN, Triple, Vector, unit

#: Below this α the lobe is narrower than any pixel, and float32 no longer resolves it.
MIN_ALPHA = 1e-3

_TABLE = 32  # entries per axis of the energy table
_TABLE_SAMPLES = 2048


@compiled
def lobe_and_pdf(view: Vector, light: Vector, alpha: float) -> tuple[float, float]:
    """Return BRDF · cosine of the light's direction, and the density per solid angle with which `sampled` draws it.

    The BRDF is uncolored and of single scattering. Both are 0 below the surface.
    """
    if view[2] <= 0 or light[2] <= 0:
        return 0.0, 0.0
    x, y, z = unit(view[0] + light[0], view[1] + light[1], view[2] + light[2])
    a2 = alpha * alpha
    # sin² from x and y: 1 - z² would lose the narrow lobes to rounding
    spread = max(z * z * a2 + x * x + y * y, 1e-20)
    distribution = a2 / (np.pi * spread * spread) / max(4 * view[2], 1e-12)
    masked, hidden = _smith_lambda(view, alpha), _smith_lambda(light, alpha)
    return distribution / (1 + masked + hidden), distribution / (1 + masked)


@compiled
def sampled(view: Vector, alpha: float, u: float, v: float) -> Triple:
    """Draw a direction to light in proportion to visible normals; it may lie below the surface.

    Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", 2023.
    """
    sx, sy, sz = unit(view[0] * alpha, view[1] * alpha, view[2])
    angle = 2 * np.pi * u
    z = (1 - v) * (1 + sz) - sz
    level = np.sqrt(min(max(1 - z * z, 0.0), 1.0))
    hx, hy, hz = unit((level * np.cos(angle) + sx) * alpha, (level * np.sin(angle) + sy) * alpha, z + sz)
    twice = 2 * (view[0] * hx + view[1] * hy + view[2] * hz)
    return twice * hx - view[0], twice * hy - view[1], twice * hz - view[2]


@compiled
def _smith_lambda(direction: Vector, alpha: float) -> float:
    """Smith's Λ: masked microsurface per visible microsurface (Walter et al. 2007)."""
    level2 = direction[0] * direction[0] + direction[1] * direction[1]
    z2 = max(direction[2] * direction[2], 1e-12)
    slope: float = np.sqrt(1 + alpha * alpha * level2 / z2)
    return 0.5 * (slope - 1)


@compiled
def scattered(
    albedo: Float[np.ndarray, "table table"],
    mean: Float[np.ndarray, " table"],
    cosine: float,
    alpha: float,
    specular: float,
) -> float:
    """Return the factor that restores the energy of multiple scattering to the lobe, from the tables of `lobe_albedo`.

    1 + F_ms (1 - E) / E with F_ms = s E_avg / (1 - s (1 - E_avg)), where s is the specular albedo, E(cosine, α) the
    lobe's albedo and E_avg its cosine-weighted mean (Turquin, "Practical Multiple Scattering Compensation for
    Microfacet Models", 2019, with the color of Kulla and Conty 2017).
    """
    last = len(mean) - 1
    u, v = np.sqrt(alpha) * last, min(max(cosine, 0.0), 1.0) * last
    i, j = max(min(int(u), last - 1), 0), max(min(int(v), last - 1), 0)  # NaN as an index is any number
    u, v = u - i, v - j
    near = albedo[i, j] * (1 - v) + albedo[i, j + 1] * v
    far = albedo[i + 1, j] * (1 - v) + albedo[i + 1, j + 1] * v
    e: float = near * (1 - u) + far * u
    e_avg: float = mean[i] * (1 - u) + mean[i + 1] * u
    bounced = specular * e_avg / (1 - specular * (1 - e_avg))
    return 1 + bounced * (1 - e) / e


@compiled
def scattering_growth(
    albedo: Float[np.ndarray, "table table"],
    mean: Float[np.ndarray, " table"],
    cosine: float,
    alpha: float,
    specular: float,
) -> float:
    """Return the derivative of log `scattered` by the specular albedo; 0 where that is 0."""
    if specular <= 0:
        return 0.0
    factor, last = scattered(albedo, mean, cosine, alpha, specular), len(mean) - 1
    u = np.sqrt(alpha) * last
    i = max(min(int(u), last - 1), 0)
    e_avg: float = mean[i] * (1 - u + i) + mean[i + 1] * (u - i)
    return (factor - 1) / (factor * specular * (1 - specular * (1 - e_avg)))


@cache
def lobe_albedo() -> tuple[Float[np.ndarray, "table table"], Float[np.ndarray, " table"]]:
    """Return the single-scattering lobe's albedo over (roughness, cosine), and its mean over cosines."""
    roughness = np.linspace(0, 1, _TABLE)
    cosine = np.linspace(0, 1, _TABLE).clip(1e-4)
    alpha = np.maximum(roughness**2, MIN_ALPHA)
    albedo = np.empty((_TABLE, _TABLE))
    _fill_in(alpha, cosine, albedo)
    fine = (np.arange(8 * _TABLE) + 0.5) / (8 * _TABLE)
    curves = np.stack([np.interp(fine, cosine, row) for row in albedo])
    return albedo, 2 * (curves * fine).mean(axis=1)


@compiled
def _fill_in(
    alpha: Float[np.ndarray, " table"], cosine: Float[np.ndarray, " table"], albedo: Float[np.ndarray, "table table"]
) -> None:
    for row in range(_TABLE):
        for column in range(_TABLE):
            view, total = (np.sqrt(1 - cosine[column] ** 2), 0.0, cosine[column]), 0.0
            for count in range(_TABLE_SAMPLES):
                light = sampled(view, alpha[row], (count + 0.5) / _TABLE_SAMPLES, count * GOLDEN % 1)
                value, density = lobe_and_pdf(view, light, alpha[row])
                if density > 0:
                    total += value / density
            albedo[row, column] = total / _TABLE_SAMPLES
