"""Pages, plots and panels of an evaluation, to look at."""
