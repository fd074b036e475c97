"""Measure the load of this machine: CPU, memory, disk, network, GPUs."""

from __future__ import annotations

import os

import psutil
import torch

MEGABYTE = 1e6


def machine_load() -> dict[str, float]:
    """Return the machine's load, by the names of MLflow's system metrics.

    CPU utilization is the mean since the last call; network traffic counts from the start of the machine.
    """
    memory, disk, network = psutil.virtual_memory(), psutil.disk_usage(os.sep), psutil.net_io_counters()
    return {
        "cpu_utilization_percentage": psutil.cpu_percent(),
        "system_memory_usage_megabytes": memory.used / MEGABYTE,
        "system_memory_usage_percentage": 100 * memory.used / memory.total,
        "disk_usage_percentage": disk.percent,
        "disk_usage_megabytes": disk.used / MEGABYTE,
        "disk_available_megabytes": disk.free / MEGABYTE,
        "network_receive_megabytes": network.bytes_recv / MEGABYTE,
        "network_transmit_megabytes": network.bytes_sent / MEGABYTE,
        **{f"gpu_{i}_{name}": value for i in range(torch.cuda.device_count()) for name, value in _gpu(i).items()},
    }


def _gpu(index: int) -> dict[str, float]:
    """Load of an NVIDIA GPU; empty if the driver does not report it."""
    try:
        used = torch.cuda.device_memory_used(index)
        return {
            "utilization_percentage": float(torch.cuda.utilization(index)),
            "memory_usage_megabytes": used / MEGABYTE,
            "memory_usage_percentage": 100 * used / torch.cuda.get_device_properties(index).total_memory,
            "power_usage_watts": torch.cuda.power_draw(index) / 1000,
        }
    except Exception:  # NVML raises exceptions of its own, and PyTorch others if NVML is missing
        return {}
