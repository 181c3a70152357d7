"""Comparison of results with the ground truth of simulated datasets, and baseline methods to compare with.

The reconstruction never reads the ground truth.
"""
