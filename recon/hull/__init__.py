"""The visual hull: carved through the refraction, trimmed to what the pictures need, and its surface."""
