"""Accuracy of lights recovered from path-traced images."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from rfpp.inference.relighting import solve_lights, with_factors
from rfpp.inference.renderer import Renderer
from rfpp.scene.packed import PackedScene
from rfpp.shards.dataset import ShardSplit

Row = dict[str, str | int | float]


def measure(
    checkpoint: str,
    root: str,
    split: str,
    scenes: int,
    views: int,
    power: float,
    pull: float,
    seed: int,
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """A row per light: its lights' power and colours are changed at random, and solved for from the true images.

    Args:
        checkpoint: of a network that is linear in lights.
        root, split: of a data set with references of little noise.
        scenes, views: so many at most.
        power: lights get between 1/power and `power` times theirs, and each colour between half and all of that.
        pull: see `solve_lights`.
        progress: called with (scenes done, scenes in all).
    """
    renderer, data = Renderer.load(checkpoint), ShardSplit(root, split)
    rng = np.random.default_rng(seed)
    count = min(scenes, len(data))
    for number in range(count):
        sample = data.read(number)
        seen = PackedScene(sample.key, sample.triangles, sample.c2w[:views], sample.fov[:views])
        target = sample.images[:views]
        wrong = {
            name: np.exp(rng.uniform(-1, 1) * np.log(power)) * rng.uniform(0.5, 1, 3)
            for name in seen.triangles.light_names
        }
        changed = with_factors(seen, wrong)
        layers = renderer.render_lights(replace(changed, name=sample.key), target.shape[1:3])
        solved = solve_lights(layers, target, np.isfinite(target).all(-1), pull=pull)
        shares = {name: float((layers[name] * factor).sum()) for name, factor in solved.factors.items()}
        for name, factor in solved.factors.items():
            ratio = factor * wrong[name]  # 1 where the light that was there is found
            yield {
                "scene": sample.key,
                "light": name,
                "lights": len(wrong),
                "share": shares[name] / max(sum(shares.values()), 1e-30),
                "intensity_error": float(abs(ratio.mean() - 1)),
                "colour_error": float(np.abs(ratio / max(ratio.mean(), 1e-30) - 1).max()),
                "difference_before": solved.before,
                "difference_after": solved.after,
            }
        progress(number + 1, count)
