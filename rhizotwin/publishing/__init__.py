"""Publication of datasets and results as a folder for a data repository."""
