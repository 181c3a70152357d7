"""Catalogue of an experiment: plants, scans, results, edits and masses in one SQLite file.

The datasets, results and tables stay plain files; the catalogue lists them with their paths and SHA-256.
"""
