"""Shoots in air: silhouettes above the net pot, their hull, and what it measures."""
