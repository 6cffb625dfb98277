"""Benchmark of the asymmetric critic, which alone is told the truth."""
