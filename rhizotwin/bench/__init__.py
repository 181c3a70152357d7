"""Benchmarks: simulated scans with exact ground truth on which any method can be run and scored."""
