"""Look at it: reference, prediction and error of a few fixed validation scenes, after every validation.

And their albedo, for networks that are given it.
"""

from __future__ import annotations

from pathlib import Path

import lightning as L
import numpy as np
from lightning.pytorch.loggers import MLFlowLogger
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.panels import error_map, panel, save_png, tone_mapped


class ImagePanels(L.Callback):
    """Writes `step-000150.png` into a folder and logs it to MLflow under `panels/`.

    Args:
        folder: where the pictures are kept.
        scenes: how many validation scenes to show, first view each.
    """

    def __init__(self, folder: str, scenes: int):
        self.folder, self.scenes = Path(folder), scenes
        self._shown: list[tuple[np.ndarray, ...]] = []

    def on_validation_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._shown = []

    def on_validation_batch_end(
        self,
        trainer: L.Trainer,
        module: L.LightningModule,
        outputs: Tensor,
        batch: RaggedBatch,
        batch_index: int,
        dataloader_index: int = 0,
    ) -> None:
        if len(self._shown) < self.scenes:
            views = [batch.image[0, 0], outputs[0, 0].clamp_min(0)]
            if module.network.gbuffer_channels[:1] == ("albedo",):
                views.append(batch.gbuffer[0, 0, :3])
            self._shown.append(tuple(v.float().permute(1, 2, 0).cpu().numpy() for v in views))

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        if trainer.fast_dev_run or not (trainer.is_global_zero and self._shown):
            return
        references, predictions, *albedos = zip(*self._shown, strict=True)
        columns = {
            "reference": [tone_mapped(r) for r in references],
            "prediction": [tone_mapped(p) for p in predictions],
            "error": [error_map(p, r) for p, r in zip(predictions, references, strict=True)],
        }
        if albedos:
            columns["albedo"] = [(np.clip(a, 0, 1) * 255).astype(np.uint8) for a in albedos[0]]
        path = save_png(panel(columns), self.folder / f"step-{trainer.global_step:06d}.png")
        for logger in trainer.loggers:
            if isinstance(logger, MLFlowLogger):
                logger.experiment.log_artifact(logger.run_id, str(path), "panels")
