"""Image metrics and trivial baselines."""
