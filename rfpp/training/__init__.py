"""Training with Lightning; it and MLflow live here and nowhere else."""
