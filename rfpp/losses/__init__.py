"""Training losses, and error growth when parts of a network are disabled."""
