"""Benchmark of the asymmetric critic, which alone is given the truth."""
