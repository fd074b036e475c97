"""A web page on which a scene is looked at and edited, rendered by a trained network."""
