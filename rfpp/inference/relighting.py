"""Lights from a picture: how bright and of which colour they would have to be for it.

An image that is linear in its lights is a sum of one image for each, so the lights of a picture are the solution of
non-negative least squares (Schoeneman et al. 1993, "Painting with light"). Squares would follow the few pixels in which
highlights and mirrored lamps stand elsewhere; least absolute differences do not. Not in the paper.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import nnls

from rfpp.scene.packed import PackedScene
from rfpp.scene.spec import Scene
from rfpp.scene.texture import MATERIAL_CHANNELS
from rfpp.scene.triangles import EMISSION

Images = Float[np.ndarray, "v h w 3"]
#: Images of two lights whose directions, as vectors, differ by less are one to the solver.
_ALIKE = 1e-3
#: A light that adds less than this share to a picture is not seen in it.
_UNSEEN = 1e-4
#: Rounds of least squares, each weighed by the last one's differences, that become least absolute differences.
_ROUNDS = 20
#: Relative differences below which all count alike.
_SMALL = 0.01


@dataclass(frozen=True)
class SolvedLights:
    """Attributes:
    factors: by light, what its red, green and blue emission is multiplied by.
    images: of the scene lit so, linear radiance.
    before, after: Σ|image − target| / Σ|target| over what counts, with the lights as they were and as solved.
    unseen: lights that add next to nothing to the target's views, which stay as they were.
    alike: pairs of lights whose images cannot be told apart; only their sum is known.
    """

    factors: dict[str, Float[np.ndarray, " 3"]]
    images: Images
    before: float
    after: float
    unseen: tuple[str, ...]
    alike: tuple[tuple[str, str], ...]


def solve_lights(
    layers: Mapping[str, Images],
    target: Images,
    counts: Bool[np.ndarray, "v h w"],
    colours: bool = True,
    pull: float = 1e-4,
) -> SolvedLights:
    """Factors of the lights, none negative, that bring the sum of their images closest to the target.

    Absolute differences are weighed by the inverse of the target's radiance plus its mean, so that shadows count as lit
    walls do.

    Args:
        layers: the images of each light alone (`Renderer.render_lights`).
        target: linear radiance.
        counts: the pixels that are compared.
        colours: whether each light's colours are solved for one by one, or its power alone.
        pull: of the factors towards 1, as a share of what a light that is seen everywhere weighs.
    """
    names, truth = list(layers), target[counts].astype(np.float64)
    columns = np.stack([layers[name][counts] for name in names], axis=-1).astype(np.float64)  # [p, 3, lights]
    weight = 1 / (truth.mean(-1, keepdims=True) + truth.mean() + 1e-12)
    lit, wanted = columns * weight[..., None], truth * weight
    size = np.sqrt(np.square(lit).sum((0, 1)))
    seen = columns.sum((0, 1)) > _UNSEEN * max(truth.sum(), 1e-30)
    factors = np.ones((len(names), 3))
    if seen.any():
        parts = range(3) if colours else [slice(None)]
        for part in parts:
            a, b = lit[:, part][..., seen].reshape(-1, seen.sum()), wanted[:, part].reshape(-1)
            factors[seen, part] = _nearest(a, b, pull)[:, None] if not colours else _nearest(a, b, pull)
    alike = [
        (names[i], names[j])
        for i, j in combinations(np.flatnonzero(seen).tolist(), 2)
        if 1 - (lit[..., i] * lit[..., j]).sum() / (size[i] * size[j]) < _ALIKE
    ]
    solved = dict(zip(names, factors, strict=True))
    images = sum(layers[name] * factor.astype(np.float32) for name, factor in solved.items())
    total = max(np.abs(truth).sum(), 1e-30)
    before, after = (np.abs(image[counts] - truth).sum() / total for image in (sum(layers.values()), images))
    unseen = tuple(name for name, visible in zip(names, seen, strict=True) if not visible)
    return SolvedLights(solved, images, float(before), float(after), unseen, tuple(alike))


def _nearest(a: Float[np.ndarray, "n lights"], b: Float[np.ndarray, " n"], pull: float) -> Float[np.ndarray, " lights"]:
    """About argmin Σ|a x − b| over x ≥ 0, by iteratively reweighted least squares."""
    factors = _nearest_in_squares(a, b, pull)
    for _ in range(_ROUNDS):
        weight = np.maximum(np.abs(a @ factors - b), _SMALL) ** -0.5
        factors = _nearest_in_squares(a * weight[:, None], b * weight, pull)
    return factors


def _nearest_in_squares(
    a: Float[np.ndarray, "n lights"], b: Float[np.ndarray, " n"], pull: float
) -> Float[np.ndarray, " lights"]:
    """argmin ‖a x − b‖² + pull · ‖a‖² ‖x − 1‖² over x ≥ 0, by the triangle that a's QR decomposition leaves."""
    if not a.any():
        return np.ones(a.shape[1])
    strength = np.sqrt(pull * np.square(a).sum(0).max())
    rows, wanted = np.linalg.qr(np.column_stack([a, b]), "r"), np.full(a.shape[1], strength)
    stacked = np.concatenate([rows[:, :-1], strength * np.eye(a.shape[1])])
    return nnls(stacked, np.concatenate([rows[:, -1], wanted]))[0]


def with_factors(scene: Scene | PackedScene, factors: Mapping[str, Float[np.ndarray, " 3"]]) -> Scene | PackedScene:
    """The scene with the emission of these objects multiplied."""
    if isinstance(scene, PackedScene):
        triangles, texture = scene.triangles, scene.texture
        material = triangles.material.copy()
        texture = None if texture is None else texture.copy()
        for name, factor in factors.items():
            of_light = triangles.object_index == triangles.object_names.index(name)
            material[of_light, EMISSION] *= factor.astype(np.float32)
            if texture is not None:
                texture[np.ix_(of_light, MATERIAL_CHANNELS[EMISSION])] *= factor.astype(np.float32)[:, None, None]
        return replace(scene, triangles=replace(triangles, material=material), texture=texture)
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
