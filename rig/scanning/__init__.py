"""The scan, what survives it, and every way out of it; its checks, markers and homing also serve a person on the bench."""
