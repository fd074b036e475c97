"""RenderFormer++ as in the paper; `renderformer` holds the baseline's own parts, `layers` what both share."""
