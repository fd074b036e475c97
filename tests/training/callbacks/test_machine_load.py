"""The machine's load has plausible values and the names that MLflow's system page expects."""

import pytest
import torch
from mlflow.system_metrics.metrics.cpu_monitor import CPUMonitor
from mlflow.system_metrics.metrics.disk_monitor import DiskMonitor
from mlflow.system_metrics.metrics.network_monitor import NetworkMonitor

from rfpp.training.callbacks.machine_load import machine_load


def collected(monitor):
    monitor.collect_metrics()
    return monitor.aggregate_metrics()


def test_names_and_values_agree_with_mlflow():
    theirs = collected(CPUMonitor()) | collected(DiskMonitor()) | collected(NetworkMonitor())
    ours = {name: value for name, value in machine_load().items() if not name.startswith("gpu_")}
    assert ours.keys() == theirs.keys()
    assert ours["system_memory_usage_percentage"] == pytest.approx(theirs["system_memory_usage_percentage"], abs=5)
    assert ours["disk_usage_megabytes"] == pytest.approx(theirs["disk_usage_megabytes"], rel=0.05)


def test_a_gpu_whose_driver_reports_nothing_is_omitted(monkeypatch):
    def unsupported(index):
        if index == 1:
            raise RuntimeError("not supported")
        return 40_000_000_000

    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "device_memory_used", unsupported)
    monkeypatch.setattr(torch.cuda, "utilization", lambda index: 75)
    monkeypatch.setattr(torch.cuda, "power_draw", lambda index: 350_000)
    monkeypatch.setattr(torch.cuda, "get_device_properties", lambda index: type("", (), {"total_memory": 80e9}))
    gpus = {name: value for name, value in machine_load().items() if name.startswith("gpu_")}
    assert gpus == {
        "gpu_0_utilization_percentage": 75.0, "gpu_0_memory_usage_megabytes": 40_000.0,
        "gpu_0_memory_usage_percentage": 50.0, "gpu_0_power_usage_watts": 350.0,
    }  # fmt: skip
