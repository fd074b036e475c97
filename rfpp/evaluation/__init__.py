"""Evaluation on stored scenes: scores, tables and reports."""
