"""What watches a training run: consistency residuals, image panels, throughput, progress."""
