"""Find the power and color of a scene's lights from a picture.

An image that is linear in its lights is a sum of one image per light, so the lights of a picture solve a non-negative
least-squares problem (Schoeneman et al. 1993, "Painting with light"). The fit minimizes absolute differences, because
squares would be dominated by a few pixels with displaced highlights. Not in the paper.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import nnls

from rfpp.scene.spec import Scene
from rfpp.scene.triangles import EMISSION

Images = Float[np.ndarray, "v h w 3"]
Factor = Float[np.ndarray, " 3"]
#: Weight of the deviation of factors from 1, relative to that of a light that is visible everywhere.
_REGULARIZATION = 1e-4
#: Cosine distance below which the images of two lights are indistinguishable.
_ALIKE = 1e-3
#: Share of a picture below which a light counts as invisible.
_INVISIBLE = 1e-4
#: Rounds of reweighted least squares, and the relative difference below which all weights are equal.
_ROUNDS, _SMALL = 20, 0.01


@dataclass(frozen=True)
class SolvedLights:
    """Solution for the lights of a picture."""

    factors: dict[str, Factor]  # of each light's red, green and blue emission
    images: Images  # with these lights
    before: float  # Σ|image − target| / Σ|target| with the original lights
    after: float  # the same with the solution
    invisible: tuple[str, ...]  # lights without effect on the target's views; their factors are 1
    alike: tuple[tuple[str, str], ...]  # pairs with indistinguishable images, of which only the sum is known


def solve_lights(
    layers: Mapping[str, Images], target: Images, is_valid: Bool[np.ndarray, "v h w"], with_colors: bool = True
) -> SolvedLights:
    """Return non-negative factors for which the sum of the lights' images is closest to the target.

    Absolute differences are divided by the target's radiance plus its mean, so that shadows count as much as lit walls.

    Args:
        layers: Images of each light alone (`Renderer.render_lights`).
        target: Linear radiance.
        is_valid: Pixels to compare.
        with_colors: Whether to solve for red, green and blue separately, or for one factor per light.
    """
    names, wanted = list(layers), target[is_valid].astype(np.float64)
    images = np.stack([layers[name][is_valid] for name in names], axis=-1).astype(np.float64)  # [p, 3, lights]
    weight = 1 / (wanted.mean(-1, keepdims=True) + wanted.mean() + 1e-12)
    a, b = images * weight[..., None], wanted * weight
    visible = images.sum((0, 1)) > _INVISIBLE * max(wanted.sum(), 1e-30)
    factors = np.ones((len(names), 3))
    if visible.any():
        channels = [[0], [1], [2]] if with_colors else [[0, 1, 2]]
        for c in channels:
            solution = _least_absolute(a[:, c][..., visible].reshape(-1, visible.sum()), b[:, c].reshape(-1))
            factors[np.ix_(visible, c)] = solution[:, None]
    norm = np.sqrt(np.square(a).sum((0, 1)))
    alike = tuple(
        (names[i], names[j])
        for i, j in combinations(np.flatnonzero(visible).tolist(), 2)
        if 1 - (a[..., i] * a[..., j]).sum() / (norm[i] * norm[j]) < _ALIKE
    )
    solved = dict(zip(names, factors, strict=True))
    relit = sum(layers[name] * factor.astype(np.float32) for name, factor in solved.items())
    total = max(np.abs(wanted).sum(), 1e-30)
    before, after = (float(np.abs(x[is_valid] - wanted).sum() / total) for x in (sum(layers.values()), relit))
    invisible = tuple(name for name, is_visible in zip(names, visible, strict=True) if not is_visible)
    return SolvedLights(solved, relit, before, after, invisible, alike)


def _least_absolute(a: Float[np.ndarray, "n lights"], b: Float[np.ndarray, " n"]) -> Float[np.ndarray, " lights"]:
    """Return about argmin Σ|a x − b| over x ≥ 0, by iteratively reweighted least squares."""
    factors = _least_squares(a, b)
    for _ in range(_ROUNDS):
        weight = np.maximum(np.abs(a @ factors - b), _SMALL) ** -0.5
        factors = _least_squares(a * weight[:, None], b * weight)
    return factors


def _least_squares(a: Float[np.ndarray, "n lights"], b: Float[np.ndarray, " n"]) -> Float[np.ndarray, " lights"]:
    """Return argmin ‖a x − b‖² + regularization · ‖a‖² ‖x − 1‖² over x ≥ 0, from the QR decomposition of a."""
    if not a.any():
        return np.ones(a.shape[1])
    strength = np.sqrt(_REGULARIZATION * np.square(a).sum(0).max())
    rows = np.linalg.qr(np.column_stack([a, b]), "r")
    stacked = np.concatenate([rows[:, :-1], strength * np.eye(a.shape[1])])
    return nnls(stacked, np.concatenate([rows[:, -1], np.full(a.shape[1], strength)]))[0]


def with_factors(scene: Scene, factors: Mapping[str, Factor]) -> Scene:
    """Return the scene with the emission of these objects multiplied."""
    objects = []
    for item in scene.objects:
        if item.name in factors:
            factor, rows = factors[item.name], item.face_material
            emissive = tuple((np.array(item.material.emissive) * factor).tolist())
            if rows is not None:
                rows = rows.copy()
                rows[:, EMISSION] *= factor.astype(rows.dtype)
            material = item.material.model_copy(update={"emissive": emissive})
            item = item.model_copy(update={"material": material, "face_material": rows})
        objects.append(item)
    return scene.model_copy(update={"objects": tuple(objects)})
