"""Measurement of the coverage of each pixel by roots: empty backlight, removal of fouling, and silhouettes."""
