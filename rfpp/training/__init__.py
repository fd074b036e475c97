"""Training with Lightning and MLflow, which no other folder imports."""
