"""How much of each pixel roots cover: the empty backlight, what is no root, silhouettes.

Coverage is sampled at points.
"""
