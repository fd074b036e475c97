"""Lightning and MLflow live here and nowhere else."""
