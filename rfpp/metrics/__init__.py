"""How images are judged, and trivial baselines to judge them by."""
