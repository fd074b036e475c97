"""From a checkpoint and a scene to pictures."""
