"""Comparison of a result with pictures that it did not use, rendered by the twin with full refraction."""
