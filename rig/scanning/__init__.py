"""The scan, what survives it, and every way out of it."""
