"""Log throughput, utilisation and time spent waiting for data."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping

import lightning as L
import torch
from torch import Tensor

from rfpp.batch import RaggedBatch
from rfpp.training.flops import matrix_product_rate, training_flops

#: What products of matrices are computed in under automatic mixed precision; float32 otherwise.
MATRIX_DTYPES = {"bf16": torch.bfloat16, "16-": torch.float16}


class Throughput(L.Callback):
    """Logs throughput over all devices, the share of time spent waiting for data, and FLOP utilisation.

    `throughput/`: steps_per_s, scenes_per_s, images_per_s, triangles_per_s, tokens_per_s (scene tokens and ray
    bundles); data_wait_fraction, of the time; flop_utilisation, what the network's forward and backward passes need
    per second, as a share of what the device achieves in large matrix products in the same precision. That is
    measured when training starts, in less than a second. The loss's own network (LPIPS) does not count, so its time
    lowers the share.

    Args:
        every_n_steps: averaging window.
        count_every_n_steps: between two batches whose operations are counted, which takes a forward pass.
    """

    def __init__(self, every_n_steps: int, count_every_n_steps: int):
        self.every_n_steps, self.count_every_n_steps = every_n_steps, count_every_n_steps

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        dtype = next((t for name, t in MATRIX_DTYPES.items() if trainer.precision.startswith(name)), torch.float32)
        self._peak = matrix_product_rate(trainer.strategy.root_device, dtype)
        self._counted_at = None
        self._begin_window()

    def on_train_batch_start(self, trainer: L.Trainer, module: L.LightningModule, batch: RaggedBatch, _: int) -> None:
        self._waited += time.perf_counter() - self._batch_end
        if self._counted_at is None or trainer.global_step - self._counted_at >= self.count_every_n_steps:
            self._counted_at = trainer.global_step
            begin = time.perf_counter()
            with trainer.precision_plugin.forward_context():
                self._flops = training_flops(module.network, batch)
            self._since += time.perf_counter() - begin  # no training time

    def on_train_batch_end(
        self,
        trainer: L.Trainer,
        module: L.LightningModule,
        outputs: Mapping[str, Tensor],
        batch: RaggedBatch,
        batch_index: int,
    ) -> None:
        images = len(batch.scenes) * batch.num_views
        height, width = batch.resolution
        bundles = images * (height // module.network.patch_size) * (width // module.network.patch_size)
        self._batches += 1
        self._done.update(
            scenes=len(batch.scenes),
            images=images,
            triangles=batch.objects.total,
            tokens=int(outputs["tokens"]) + bundles,
        )
        steps = self._batches // trainer.accumulate_grad_batches
        if steps == self.every_n_steps:
            elapsed = time.perf_counter() - self._since
            rates = {f"{name}_per_s": trainer.world_size * count / elapsed for name, count in self._done.items()}
            shares = {
                "data_wait_fraction": self._waited / elapsed,
                "flop_utilisation": self._flops * self._batches / elapsed / self._peak,
            }
            values = {"steps_per_s": steps / elapsed, **rates, **shares}
            module.log_dict({f"throughput/{name}": value for name, value in values.items()}, batch_size=1)
            self._begin_window()
        self._batch_end = time.perf_counter()

    def on_validation_end(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        if not trainer.sanity_checking:
            self._begin_window()  # validation is not training time

    def _begin_window(self) -> None:
        self._since = self._batch_end = time.perf_counter()
        self._waited, self._batches, self._done = 0.0, 0, Counter()
