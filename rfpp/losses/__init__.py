"""What training minimises, and what gets worse when a part of a network is taken away."""
