"""What things cost and what they are worth beside Cycles: time, memory, quality."""
