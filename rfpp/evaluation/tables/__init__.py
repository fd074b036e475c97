"""Tables of results: the paper's with ours beside them, light transport, and what an evaluation prints."""
