"""Coverage of each pixel by roots: estimation of the empty backlight, removal of fouling, and silhouettes."""
