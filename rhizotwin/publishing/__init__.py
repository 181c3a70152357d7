"""Datasets and results as a folder that a data repository takes as it is."""
