"""Image metrics, and trivial baselines to compare with."""
