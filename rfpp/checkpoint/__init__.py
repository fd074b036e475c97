"""Files and networks: checkpoints, model folders, released RenderFormer weights, shipped models."""
