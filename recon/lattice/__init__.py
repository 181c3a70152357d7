"""Compiled loops over pictures, and over sparse sets of cells of a cubic lattice."""
