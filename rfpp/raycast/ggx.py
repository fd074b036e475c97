"""The glossy lobe of our materials: GGX with height-correlated Smith shadowing and energy-preserving scaling.

No Fresnel term; the specular albedo colors the lobe, as in Cycles' "Multiscatter GGX". All vectors are unit vectors in
the frame of the shading normal, (..., 3) with z along it; α is the square of the roughness.
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

Vectors = Float[np.ndarray, "*batch 3"]
Scalars = Float[np.ndarray, "*batch"]


def lobe(view: Vectors, light: Vectors, alpha: Scalars) -> Scalars:
    """Return BRDF · cosine of the light's direction for single scattering, uncolored; 0 below the surface."""
    return _of_pairs(view, light, alpha)[0]


def pdf(view: Vectors, light: Vectors, alpha: Scalars) -> Scalars:
    """Return the density per solid angle with which `sample` draws `light`."""
    return _of_pairs(view, light, alpha)[1]


def sample(view: Vectors, alpha: Scalars, random: Float[np.ndarray, "*batch 2"]) -> Vectors:
    """Draw directions to light in proportion to visible normals; they may lie below the surface.

    Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", 2023.
    """
    direction = np.empty((alpha.size, 3))
    _sample_each(_rows(view), _flat(alpha), np.ascontiguousarray(random, np.float64).reshape(-1, 2), direction)
    return direction.reshape(*alpha.shape, 3)


def multiple_scattering(
    cosine: Float[np.ndarray, " r"], alpha: Float[np.ndarray, " r"], specular: Float[np.ndarray, "r 3"]
) -> Float[np.ndarray, "r 3"]:
    """Return the factor that restores the energy of multiple scattering to the single-scattering lobe.

    1 + F_ms (1 - E) / E with F_ms = s E_avg / (1 - s (1 - E_avg)), where s is the specular albedo, E(cosine, α) the
    lobe's albedo and E_avg its cosine-weighted mean (Turquin, "Practical Multiple Scattering Compensation for
    Microfacet Models", 2019, with the color of Kulla and Conty 2017).
    """
    factor = np.empty((len(alpha), 3))
    _scattering_each(_flat(cosine), _flat(alpha), _rows(specular), *lobe_albedo(), factor)
    return factor


@compiled
def lobe_and_pdf(view: Vector, light: Vector, alpha: float) -> tuple[float, float]:
    """Return `lobe` and `pdf` of two vectors."""
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
    """Draw one direction; see `sample`."""
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
def _lobe_and_pdf_each(
    view: Float[np.ndarray, "r 3"],
    light: Float[np.ndarray, "r 3"],
    alpha: Float[np.ndarray, " r"],
    found: Float[np.ndarray, "2 r"],
) -> None:
    for row in range(len(alpha)):
        found[0, row], found[1, row] = lobe_and_pdf(view[row], light[row], alpha[row])


@compiled
def _sample_each(
    view: Float[np.ndarray, "r 3"],
    alpha: Float[np.ndarray, " r"],
    random: Float[np.ndarray, "r 2"],
    direction: Float[np.ndarray, "r 3"],
) -> None:
    for row in range(len(alpha)):
        direction[row, 0], direction[row, 1], direction[row, 2] = sampled(
            view[row], alpha[row], random[row, 0], random[row, 1]
        )


@compiled
def scattered(
    albedo: Float[np.ndarray, "table table"],
    mean: Float[np.ndarray, " table"],
    cosine: float,
    alpha: float,
    specular: float,
) -> float:
    """Return `multiple_scattering` of one surface and color, from the tables of `lobe_albedo`."""
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


@compiled
def _scattering_each(
    cosine: Float[np.ndarray, " r"],
    alpha: Float[np.ndarray, " r"],
    specular: Float[np.ndarray, "r 3"],
    albedo: Float[np.ndarray, "table table"],
    mean: Float[np.ndarray, " table"],
    factor: Float[np.ndarray, "r 3"],
) -> None:
    for row in range(len(alpha)):
        for c in range(3):
            factor[row, c] = scattered(albedo, mean, cosine[row], alpha[row], specular[row, c])


def _of_pairs(view: Vectors, light: Vectors, alpha: Scalars) -> tuple[Scalars, Scalars]:
    found = np.empty((2, alpha.size))
    _lobe_and_pdf_each(_rows(view), _rows(light), _flat(alpha), found)
    return found[0].reshape(alpha.shape), found[1].reshape(alpha.shape)


def _rows(vectors: np.ndarray) -> Float[np.ndarray, "n 3"]:
    return np.ascontiguousarray(vectors, np.float64).reshape(-1, 3)


def _flat(numbers: np.ndarray) -> Float[np.ndarray, " n"]:
    return np.ascontiguousarray(numbers, np.float64).reshape(-1)


@cache
def lobe_albedo() -> tuple[Float[np.ndarray, "table table"], Float[np.ndarray, " table"]]:
    """Return the single-scattering lobe's albedo over (roughness, cosine), and its mean over cosines."""
    roughness = np.linspace(0, 1, _TABLE)
    cosine = np.linspace(0, 1, _TABLE).clip(1e-4)
    alpha = np.maximum(roughness**2, MIN_ALPHA)
    count = np.arange(_TABLE_SAMPLES)
    random = np.stack([(count + 0.5) / _TABLE_SAMPLES, count * GOLDEN % 1], axis=-1)
    albedo = np.empty((_TABLE, _TABLE))
    for row in range(_TABLE):
        view = np.stack([np.sqrt(1 - cosine**2), np.zeros(_TABLE), cosine], axis=-1)
        view = np.broadcast_to(view, (_TABLE_SAMPLES, _TABLE, 3))
        alphas = np.full(view.shape[:-1], alpha[row])
        light = sample(view, alphas, np.broadcast_to(random[:, None], (_TABLE_SAMPLES, _TABLE, 2)))
        value, density = _of_pairs(view, light, alphas)
        albedo[row] = np.divide(value, density, out=np.zeros_like(value), where=density > 0).mean(0)
    fine = (np.arange(8 * _TABLE) + 0.5) / (8 * _TABLE)
    curves = np.stack([np.interp(fine, cosine, row) for row in albedo])
    return albedo, 2 * (curves * fine).mean(axis=1)
