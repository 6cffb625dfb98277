"""Benchmark of learning on estimates in environments of third parties."""
