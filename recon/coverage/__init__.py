"""How much of each pixel roots cover: the empty backlight, what is no root, silhouettes, and coverage sampled at points."""
