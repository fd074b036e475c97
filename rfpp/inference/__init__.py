"""From a checkpoint and a scene to pictures: the `Renderer`, stills and films."""
