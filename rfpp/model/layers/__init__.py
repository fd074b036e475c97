"""Layers shared by RenderFormer++ and RenderFormer."""
