"""Benchmarks of time, memory and image quality, also beside Cycles (`launch/benchmark.py`)."""
