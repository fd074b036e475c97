"""What things cost: ground truth, reading data."""
