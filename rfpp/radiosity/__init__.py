"""Ray-cast radiosity with a learned refinement: light exchanged between surface cells, gathered by pixels."""
