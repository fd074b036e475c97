"""Log system metrics: CPU, memory, disk, network, and NVIDIA GPUs."""

from __future__ import annotations

import os
import threading

import lightning as L
import psutil

MEGABYTE = 1e6


class SystemMetrics(L.Callback):
    """Logs system metrics of rank 0's machine as `system/…`, with MLflow's names, for its system page.

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
        machine = Machine()
        self._stopped.wait(1.0)  # the processor's use is counted from the one before
        while True:
            values = {f"system/{name}": round(value, 1) for name, value in machine.sample().items()}
            for logger in trainer.loggers:
                logger.log_metrics(values, trainer.global_step)
            if self._stopped.wait(self.every_n_seconds):
                return


class Machine:
    """Counters of one machine: processor use since the last sample, network traffic since the first."""

    def __init__(self):
        psutil.cpu_percent()
        self._network = psutil.net_io_counters()
        self._gpus = _Gpus()

    def sample(self) -> dict[str, float]:
        """Values by MLflow's names, which include units; megabytes are 10⁶ bytes."""
        memory, disk, network = psutil.virtual_memory(), psutil.disk_usage(os.sep), psutil.net_io_counters()
        return {
            "cpu_utilization_percentage": psutil.cpu_percent(),
            "system_memory_usage_megabytes": memory.used / MEGABYTE,
            "system_memory_usage_percentage": 100 * memory.used / memory.total,
            "disk_usage_percentage": disk.percent,
            "disk_usage_megabytes": disk.used / MEGABYTE,
            "disk_available_megabytes": disk.free / MEGABYTE,
            "network_receive_megabytes": (network.bytes_recv - self._network.bytes_recv) / MEGABYTE,
            "network_transmit_megabytes": (network.bytes_sent - self._network.bytes_sent) / MEGABYTE,
            **self._gpus.sample(),
        }


class _Gpus:
    """NVIDIA GPUs, if any; values that a driver does not report are omitted."""

    def __init__(self):
        self._handles = []
        try:
            import pynvml

            pynvml.nvmlInit()
            self._nvml = pynvml
            self._handles = [pynvml.nvmlDeviceGetHandleByIndex(i) for i in range(pynvml.nvmlDeviceGetCount())]
        except Exception:  # no library, no driver, no GPU
            return

    def sample(self) -> dict[str, float]:
        values: dict[str, float] = {}
        for index, handle in enumerate(self._handles):
            for measure in (self._memory, self._use, self._power):
                try:
                    values |= {f"gpu_{index}_{name}": value for name, value in measure(handle).items()}
                except self._nvml.NVMLError:
                    continue
        return values

    def _memory(self, handle) -> dict[str, float]:
        memory = self._nvml.nvmlDeviceGetMemoryInfo(handle)
        return {
            "memory_usage_percentage": 100 * memory.used / memory.total,
            "memory_usage_megabytes": memory.used / MEGABYTE,
        }

    def _use(self, handle) -> dict[str, float]:
        return {"utilization_percentage": float(self._nvml.nvmlDeviceGetUtilizationRates(handle).gpu)}

    def _power(self, handle) -> dict[str, float]:
        watts = self._nvml.nvmlDeviceGetPowerUsage(handle) / 1000
        limit = self._nvml.nvmlDeviceGetEnforcedPowerLimit(handle) / 1000
        return {"power_usage_watts": watts, "power_usage_percentage": 100 * watts / limit}
