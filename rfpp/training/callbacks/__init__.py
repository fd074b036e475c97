"""Callbacks: consistency, image panels, throughput, checkpoints, use of network parts."""
