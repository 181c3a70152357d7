"""Reconstruction of roots from a dataset of pictures: camera poses, silhouettes, shape, volume and its interval."""
