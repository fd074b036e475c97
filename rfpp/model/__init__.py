"""The network: plain arguments in, tensors out. Begin with `renderformer_pp`."""
