"""Reconstruction: a dataset of pictures becomes poses, silhouettes, a shape, its volume and a score."""
