"""Visual hull: octree carving with refraction, trimming to the volume that the silhouettes require, and its surface."""
