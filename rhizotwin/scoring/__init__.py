"""Comparison of results with the ground truth of simulated datasets, which the reconstruction never reads."""
