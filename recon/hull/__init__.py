"""The visual hull: carving with refraction, trimming to what the silhouettes require, and the surface."""
