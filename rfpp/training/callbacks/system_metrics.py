"""What the machine does meanwhile: processor, memory, disk, network, and GPUs where NVIDIA's library is installed."""

from __future__ import annotations

import threading

import lightning as L
from mlflow.system_metrics.metrics.base_metrics_monitor import BaseMetricsMonitor
from mlflow.system_metrics.metrics.cpu_monitor import CPUMonitor
from mlflow.system_metrics.metrics.disk_monitor import DiskMonitor
from mlflow.system_metrics.metrics.gpu_monitor import GPUMonitor
from mlflow.system_metrics.metrics.network_monitor import NetworkMonitor


class SystemMetrics(L.Callback):
    """Logs MLflow's system metrics of rank 0's machine, as `system/…`, at training's steps.

    MLflow's own monitor ends when its server is away for a moment; these go the way of all other metrics.

    Args:
        every_n_seconds: between two samples.
    """

    def __init__(self, every_n_seconds: float):
        self.every_n_seconds = every_n_seconds
        self._stopped = threading.Event()
        self._sampler: threading.Thread | None = None

    def on_train_start(self, trainer: L.Trainer, module: L.LightningModule) -> None:
        if trainer.is_global_zero:
            self._sampler = threading.Thread(target=self._sample, args=(trainer,), name="system-metrics", daemon=True)
            self._sampler.start()

    def teardown(self, trainer: L.Trainer, module: L.LightningModule, stage: str) -> None:
        if self._sampler is not None:
            self._stopped.set()
            self._sampler.join()

    def _sample(self, trainer: L.Trainer) -> None:
        monitors = _monitors()
        monitors[0].collect_metrics()  # the processor's use is counted from here
        self._stopped.wait(1.0)
        while True:
            values = {}
            for monitor in monitors:
                monitor.clear_metrics()
                monitor.collect_metrics()
                values |= monitor.aggregate_metrics()
            for logger in trainer.loggers:
                logger.log_metrics({f"system/{name}": value for name, value in values.items()}, trainer.global_step)
            if self._stopped.wait(self.every_n_seconds):
                return


def _monitors() -> list[BaseMetricsMonitor]:
    monitors = [CPUMonitor(), DiskMonitor(), NetworkMonitor()]
    try:
        monitors.append(GPUMonitor())
    except Exception:  # no GPU, or no nvidia-ml-py: MLflow raises all kinds
        return monitors
    return monitors
