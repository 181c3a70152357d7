"""Reconstruction or simulation of many scans: search for datasets, execution of jobs, records, and overview page."""
