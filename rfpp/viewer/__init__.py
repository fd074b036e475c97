"""The web page on which a scene is looked at and edited."""
