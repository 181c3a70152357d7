"""Batches of scans: finding the datasets, running the jobs, recording their outcomes, and an overview page."""
