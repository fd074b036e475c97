"""What watches a training run: consistency, image panels, throughput, signs of life."""
