"""Lightning callbacks: checkpoints, exact resumption, logging."""
