"""Train a refinement of a network's images, on what it renders of a data set; the network itself stays as it is.

python launch/generate.py experiment=rfpp_real
python launch/refine.py experiment=rfpp_real checkpoint=rfpp-tiny

Images are rendered once and kept, so the same command goes on where it was stopped while rendering.
"""

from __future__ import annotations

import rfpp.interrupts  # noqa: F401 (first: what follows takes seconds to import)

# isort: split
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import mean

import numpy as np
from lightning.pytorch.loggers import CSVLogger
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from rfpp import Renderer
from rfpp.checkpoint.loading import load_network
from rfpp.commands import entry_point
from rfpp.progress import counting
from rfpp.training.callbacks.progress_bar import TrainingProgress
from rfpp.training.callbacks.progress_log import TrainingLines
from rfpp.training.config_file import write_config
from rfpp.training.refining.fitting import fitted, rendered
from rfpp.training.refining.module import Validation
from rfpp.training.tracking.description import code_version

#: What the method of a refined network is called besides.
_REFINED = ", refined"
#: From what share on an error that grew again is worth a word.
_WORSE = 0.01


@entry_point("refine")
def main(cfg: DictConfig) -> Path:
    """Refine `cfg.checkpoint` by `cfg.data`; returns the refined network's folder."""
    console = Console(highlight=False, soft_wrap=True)
    plan, renderer = cfg.refining, Renderer.load(cfg.checkpoint, "cpu")
    with counting(console, "scenes of train") as (show, _):
        views = rendered(cfg, renderer, "train", plan.scenes, show)
    with counting(console, "scenes of validation") as (show, _):
        validation = rendered(cfg, renderer, "validation", None, show)
    write_config(cfg, Path(cfg.run_dir))
    callbacks = [TrainingProgress(), TrainingLines(60.0)]
    module = fitted(cfg, views, validation, CSVLogger(cfg.run_dir, name="", version=""), callbacks)
    console.print(_gain(module.validations[-1], [file for file, _ in validation.views]))
    if advice := _advice(module.validations):
        console.print(advice)

    network, info = load_network(cfg.checkpoint)
    network.refinement = module.refinement
    model = info.model | {"refinement": OmegaConf.to_container(cfg.refinement, resolve=True)}
    method = info.method.removesuffix(_REFINED) + _REFINED
    info = replace(info, model=model, method=method, commit=code_version())
    learned = f"{plan.steps} steps on {len(views)} images of {cfg.data.name} (manifest {views.manifest.hash[:12]})"
    folder = Renderer(network.eval(), info).save(
        cfg.output, notes=f"- Its images are refined by what was learned in {learned}."
    )
    console.print(f"Network: {folder}")
    return folder


def _gain(last: Validation, scenes: Sequence[Path]) -> str:
    """What refinement is worth on validation images, with the 95% interval over scenes of the paired difference."""
    _, scene = np.unique(scenes, return_inverse=True)
    now, before = (np.bincount(scene, errors) / np.bincount(scene) for errors in (last.refined, last.unrefined))
    share = (now - before) / before.mean()
    interval = 1.96 * share.std(ddof=1) / np.sqrt(len(share))
    return f"Validation log-L1 {before.mean():.5f} → {now.mean():.5f} ({share.mean():+.1%} ± {interval:.1%})"


def _advice(validations: Sequence[Validation]) -> str | None:
    """What to do where training went on for so long that the training images were learned by heart."""
    best = min(validations, key=lambda at: mean(at.refined))
    least, last = mean(best.refined), mean(validations[-1].refined)
    if least > (1 - _WORSE) * last:
        return None
    return (
        f"It was better after {best.step} steps ({least:.5f}), then learned its images by heart: "
        f"refining.steps={best.step} stops there; more scenes help more"
    )


if __name__ == "__main__":
    main()
