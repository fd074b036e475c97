"""The glossy lobe of our materials: GGX with height-correlated Smith shadowing and energy-preserving scaling.

No Fresnel term; the specular albedo tints. As in Cycles' "Multiscatter GGX". All vectors are unit vectors in the
frame of the shading normal, (..., 3) with z along it; α is the square of the roughness.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float

#: Below this α the lobe is narrower than any pixel, and float32 no longer resolves it.
MIN_ALPHA = 1e-3

_TABLE = 32  # entries per axis of the energy table
_TABLE_SAMPLES = 2048

Vectors = Float[np.ndarray, "*batch 3"]
Scalars = Float[np.ndarray, "*batch"]


def lobe(view: Vectors, light: Vectors, alpha: Scalars) -> Scalars:
    """BRDF · cosine of the light's direction, single scattering, untinted; 0 below the surface."""
    above = (view[..., 2] > 0) & (light[..., 2] > 0)
    half = _unit(view + light)
    shadowing = 1 / (1 + _smith_lambda(view, alpha) + _smith_lambda(light, alpha))
    value = _distribution(half, alpha) * shadowing / np.maximum(4 * view[..., 2], 1e-12)
    return np.where(above, value, 0)


def pdf(view: Vectors, light: Vectors, alpha: Scalars) -> Scalars:
    """Density per solid angle with which `sample` returns `light`."""
    above = (view[..., 2] > 0) & (light[..., 2] > 0)
    half = _unit(view + light)
    masking = 1 / (1 + _smith_lambda(view, alpha))
    return np.where(above, _distribution(half, alpha) * masking / np.maximum(4 * view[..., 2], 1e-12), 0)


def sample(view: Vectors, alpha: Scalars, random: Float[np.ndarray, "*batch 2"]) -> Vectors:
    """A direction to look for light in, in proportion to the normals that are visible; may lie below the surface.

    Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", 2023.
    """
    stretch = np.stack([alpha, alpha, np.ones_like(alpha)], axis=-1)
    standard = _unit(view * stretch)
    angle = 2 * np.pi * random[..., 0]
    z = (1 - random[..., 1]) * (1 + standard[..., 2]) - standard[..., 2]
    level = np.sqrt(np.clip(1 - z**2, 0, 1))
    cap = np.stack([level * np.cos(angle), level * np.sin(angle), z], axis=-1)
    half = _unit((cap + standard) * stretch)
    return 2 * (view * half).sum(-1, keepdims=True) * half - view


def multiple_scattering(
    cosine: Float[np.ndarray, " r"], alpha: Float[np.ndarray, " r"], specular: Float[np.ndarray, "r 3"]
) -> Float[np.ndarray, "r 3"]:
    """What the single-scattering lobe is multiplied by to give back the energy that leaves after further bounces.

    1 + F_ms (1 - E) / E with F_ms = s E_avg / (1 - s (1 - E_avg)), where s is the specular albedo, E(cosine, α) the
    lobe's albedo and E_avg its cosine-weighted mean (Turquin, "Practical Multiple Scattering Compensation for
    Microfacet Models", 2019, with the colour of Kulla and Conty 2017).
    """
    albedo, mean = _lobe_albedo()
    row = np.sqrt(alpha) * (_TABLE - 1)
    of_cosine = np.clip(cosine, 0, 1) * (_TABLE - 1)
    i, j = (np.minimum(a.astype(int), _TABLE - 2) for a in (row, of_cosine))
    u, v = row - i, of_cosine - j
    near = albedo[i, j] * (1 - v) + albedo[i, j + 1] * v
    far = albedo[i + 1, j] * (1 - v) + albedo[i + 1, j + 1] * v
    e = (near * (1 - u) + far * u)[:, None]
    e_avg = (mean[i] * (1 - u) + mean[i + 1] * u)[:, None]
    bounced = specular * e_avg / (1 - specular * (1 - e_avg))
    return 1 + bounced * (1 - e) / e


@cache
def _lobe_albedo() -> tuple[Float[np.ndarray, "table table"], Float[np.ndarray, " table"]]:
    """The share of light the single-scattering lobe reflects, over (roughness, cosine), and its mean over cosines."""
    roughness = np.linspace(0, 1, _TABLE)
    cosine = np.linspace(0, 1, _TABLE).clip(1e-4)
    alpha = np.maximum(roughness**2, MIN_ALPHA)
    count = np.arange(_TABLE_SAMPLES)
    random = np.stack([(count + 0.5) / _TABLE_SAMPLES, count * 0.6180339887498949 % 1], axis=-1)
    albedo = np.empty((_TABLE, _TABLE))
    for row in range(_TABLE):
        view = np.stack([np.sqrt(1 - cosine**2), np.zeros(_TABLE), cosine], axis=-1)
        view = np.broadcast_to(view, (_TABLE_SAMPLES, _TABLE, 3))
        alphas = np.full(view.shape[:-1], alpha[row])
        light = sample(view, alphas, np.broadcast_to(random[:, None], (_TABLE_SAMPLES, _TABLE, 2)))
        shadowing = (1 + _smith_lambda(view, alphas)) / (1 + _smith_lambda(view, alphas) + _smith_lambda(light, alphas))
        albedo[row] = np.where(light[..., 2] > 0, shadowing, 0).mean(0)
    fine = (np.arange(8 * _TABLE) + 0.5) / (8 * _TABLE)
    curves = np.stack([np.interp(fine, cosine, row) for row in albedo])
    return albedo, 2 * (curves * fine).mean(axis=1)


def _distribution(half: Vectors, alpha: Scalars) -> Scalars:
    """Density of GGX normals (Walter et al. 2007)."""
    z2, a2 = half[..., 2] ** 2, alpha**2
    # sin² from x and y: 1 - z² would lose the narrow lobes to rounding
    spread = z2 * a2 + half[..., 0] ** 2 + half[..., 1] ** 2
    return a2 / (np.pi * np.maximum(spread, 1e-20) ** 2)


def _smith_lambda(direction: Vectors, alpha: Scalars) -> Scalars:
    """Smith's Λ: masked microsurface per visible microsurface."""
    level2 = direction[..., 0] ** 2 + direction[..., 1] ** 2
    z2 = np.maximum(direction[..., 2] ** 2, 1e-12)
    return 0.5 * (np.sqrt(1 + alpha**2 * level2 / z2) - 1)


def _unit(vectors: Vectors) -> Vectors:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-20)
