"""Parts of the baseline, RenderFormer (Zeng et al. 2025), that RenderFormer++ replaces."""
