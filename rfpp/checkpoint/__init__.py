"""Load and save networks: checkpoints, model folders, released RenderFormer weights, shipped models."""
