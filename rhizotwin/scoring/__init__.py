"""Comparison of results with the ground truth of simulated datasets.

The reconstruction never reads the ground truth.
"""
