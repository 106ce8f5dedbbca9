"""Comparisons of `experiments/benchmark.py`, one per file."""
