"""RenderFormer++: plain arguments in, tensors out."""
