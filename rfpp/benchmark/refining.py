"""What more scenes, and more minutes of training, are worth to a refinement."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from statistics import mean
from typing import Any

from rfpp.inference.renderer import Renderer
from rfpp.training.refining.fitting import fitted, rendered

Row = dict[str, str | int | float]


def measure(
    compose: Callable[[list[str]], Mapping[str, Any]],
    overrides: Sequence[str],
    scenes: Sequence[int],
    progress: Callable[[int, int], None],
) -> Iterator[Row]:
    """Trains a refinement on each number of scenes: rows of mean log-L1 on validation images, refined and not, after so
    many minutes.

    Minutes are of training alone. Views are rendered before, once for all.

    Args:
        compose: overrides → the configuration of launch/refine.py.
        overrides: of all trainings.
        scenes: of the training split, the first so many.
        progress: called with (trainings done, in all).
    """
    for number, count in enumerate(scenes):
        cfg = compose([*overrides, f"refining.scenes={count}"])
        renderer = Renderer.load(cfg["checkpoint"], "cpu")
        of_splits = (("train", count), ("validation", None))
        views, validation = (rendered(cfg, renderer, *split, lambda *_: None) for split in of_splits)
        module = fitted(cfg, views, validation, False, [])
        progress(number + 1, len(scenes))
        for at in module.validations:
            yield {
                "data": cfg["data"]["name"],
                "scenes": len(views.files),
                "images": len(views),
                "step": at.step,
                "minutes": at.minutes,
                "log_l1": mean(at.refined),
                "unrefined_log_l1": mean(at.unrefined),
            }
