"""Stored data sets: generation, WebDataset tars, random access, order, verification."""
