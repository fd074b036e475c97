"""Tables of results: in the terminal, and the paper's with ours beside them."""
