"""How images are judged: image metrics, LPIPS, and trivial baselines to judge them by."""
