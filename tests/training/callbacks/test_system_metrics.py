"""The machine's state has the names that MLflow's page of it knows, and sound values."""

import sys
from types import SimpleNamespace

import pytest
from mlflow.system_metrics.metrics import gpu_monitor
from mlflow.system_metrics.metrics.cpu_monitor import CPUMonitor
from mlflow.system_metrics.metrics.disk_monitor import DiskMonitor
from mlflow.system_metrics.metrics.network_monitor import NetworkMonitor

from rfpp.training.callbacks.system_metrics import Machine


class FakeNvmlError(Exception):
    pass


def refused(handle):
    raise FakeNvmlError


@pytest.fixture
def nvml(monkeypatch):
    """Two GPUs that are half used."""
    library = SimpleNamespace(
        NVMLError=FakeNvmlError,
        nvmlInit=lambda: None,
        nvmlDeviceGetCount=lambda: 2,
        nvmlDeviceGetHandleByIndex=lambda index: index,
        nvmlDeviceGetMemoryInfo=lambda handle: SimpleNamespace(used=40e9, total=80e9),
        nvmlDeviceGetUtilizationRates=lambda handle: SimpleNamespace(gpu=75),
        nvmlDeviceGetPowerUsage=lambda handle: 350_000,
        nvmlDeviceGetEnforcedPowerLimit=lambda handle: 700_000,
    )
    monkeypatch.setitem(sys.modules, "pynvml", library)
    monkeypatch.setattr(gpu_monitor, "pynvml", library, raising=False)
    return library


def collected(monitor):
    monitor.collect_metrics()
    return monitor.aggregate_metrics()


def test_names_are_those_of_mlflow(nvml):
    monitors = (CPUMonitor(), DiskMonitor(), NetworkMonitor(), gpu_monitor.GPUMonitor())
    theirs = {name: value for monitor in monitors for name, value in collected(monitor).items()}
    ours = Machine().sample()
    assert ours.keys() == theirs.keys()
    of_gpus = [name for name in ours if name.startswith("gpu_")]
    assert [ours[name] for name in of_gpus] == [theirs[name] for name in of_gpus]
    assert ours["system_memory_usage_percentage"] == pytest.approx(theirs["system_memory_usage_percentage"], abs=5)
    assert ours["disk_usage_megabytes"] == pytest.approx(theirs["disk_usage_megabytes"], rel=0.05)


def test_what_a_driver_does_not_tell_is_left_out(nvml):
    nvml.nvmlDeviceGetPowerUsage = refused
    names = {name for name in Machine().sample() if name.startswith("gpu_1")}
    assert names == {"gpu_1_memory_usage_percentage", "gpu_1_memory_usage_megabytes", "gpu_1_utilization_percentage"}


@pytest.mark.parametrize("absent", ["library", "driver"])
def test_without_gpus_the_rest_is_there(nvml, monkeypatch, absent):
    if absent == "library":
        monkeypatch.setitem(sys.modules, "pynvml", None)
    else:
        nvml.nvmlInit = lambda: refused(None)
    values = Machine().sample()
    assert "cpu_utilization_percentage" in values
    assert not [name for name in values if name.startswith("gpu_")]
