"""Log images of fixed validation scenes beside their references, bounce by bounce."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import lightning as L
import numpy as np
import torch
from torch import Tensor, distributed

from rfpp.batch import RaggedBatch
from rfpp.imaging.panels import Picture, panel, save_picture, signed_error_map, tone_mapped
from rfpp.imaging.radiance import log_decode
from rfpp.training.tracking.run_logger import RunLogger

#: Pictures of a scene, by sheet and column.
Row = dict[str, dict[str, Picture]]


class ImagePanels(L.Callback):
    """Writes image sheets with one row per scene, and logs them as artifacts in `panels/`.

    `panels-000150.png`, after step 150: reference, prediction, signed error, and albedo if the network reads it.
    `bounces-000150.png`: the image decoded after each application of the transport operator, if the network has one.
    """

    def __init__(self, folder: str, scenes: int):
        self.folder, self.scenes = Path(folder), scenes
        self._rows: dict[int, Row] = {}

    def on_validation_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        self._rows = {}

    def on_validation_batch_end(
        self,
        trainer: L.Trainer,
        module: L.LightningModule,
        outputs: Mapping[str, Tensor],
        batch: RaggedBatch,
        batch_index: int,
        dataloader_index: int = 0,
    ) -> None:
        scene = batch_index * trainer.world_size + trainer.global_rank  # ranks take turns
        if scene < self.scenes:
            with trainer.precision_plugin.forward_context():
                self._rows[scene] = pictures(module.network, batch, outputs["radiance"])

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        rows = _gather(self._rows)
        if not (trainer.is_global_zero and rows):
            return
        for sheet in rows[0]:
            columns = {name: [row[sheet][name] for row in rows] for name in rows[0][sheet]}
            path = save_picture(panel(columns), self.folder / f"{sheet}-{trainer.global_step:06d}.png")
            for logger in trainer.loggers:
                if isinstance(logger, RunLogger):
                    logger.log_file(path, "panels")


@torch.no_grad()
def pictures(network: torch.nn.Module, batch: RaggedBatch, radiance: Tensor) -> Row:
    """Return the pictures of a batch's first scene, from its first camera.

    Args:
        radiance: Prediction [B, V, 3, H, W].
    """
    reference, prediction = _image(batch.image), _image(radiance)
    row = {
        "panels": {
            "reference": tone_mapped(reference),
            "prediction": tone_mapped(prediction),
            "blue: too dark, red: too bright": signed_error_map(prediction, reference),
        }
    }
    if network.gbuffer_channels[:1] == ("albedo",):
        row["panels"]["albedo"] = tone_mapped(_image(batch.gbuffer[:, :, :3]))
    if network.iterations:
        scenes, _ = network.transported_each(*network.tokenize(batch), network.iterations)
        view = (batch.c2w[:, :1], batch.fov[:, :1], batch.gbuffer[:, :1])
        images = (_image(log_decode(network.view(scene, *view))) for scene in scenes)
        row["bounces"] = {f"after {k} bounces": tone_mapped(image) for k, image in enumerate(images)}
        row["bounces"]["reference"] = row["panels"]["reference"]
    return row


def _image(images: Tensor) -> np.ndarray:
    return images[0, 0].float().clamp_min(0).permute(1, 2, 0).cpu().numpy()


def _gather(rows: dict[int, Row]) -> list[Row]:
    """Return the rows of all ranks in the order of the scenes; empty on all ranks but the first."""
    gathered = [rows]
    if distributed.is_available() and distributed.is_initialized():
        gathered = [None] * distributed.get_world_size() if distributed.get_rank() == 0 else None
        distributed.gather_object(rows, gathered)
    merged = {scene: row for of_rank in gathered or [] for scene, row in of_rank.items()}
    return [merged[scene] for scene in sorted(merged)]
