"""Benchmarks of simulated scans with exact ground truth, on which any reconstruction method can be run and scored."""
