"""Reading of result folders: checks, values and tables."""
