"""The scan, what survives it, and every way out of it.

Its checks, markers and homing also serve a person on the bench.
"""
