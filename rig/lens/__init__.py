"""Camera lens calibration from pictures of a printed board."""
