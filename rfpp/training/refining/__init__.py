"""Training of a network's last stage, the refinement, on images that the network has rendered."""
