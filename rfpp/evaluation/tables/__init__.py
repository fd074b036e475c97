"""Tables: the paper's with ours beside them, light transport, what an evaluation prints."""
