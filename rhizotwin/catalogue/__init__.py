"""Catalogue of an experiment: an SQLite file that lists plants, scans, results, corrections and masses.

Datasets, results and tables remain separate files, whose paths and SHA-256 are stored in the catalogue.
"""
