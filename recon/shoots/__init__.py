"""Reconstruction of shoots in air: silhouettes above the net pot, visual hull, and measurements."""
