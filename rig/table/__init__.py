"""Turntable and lights: the Marlin board, or a Raspberry Pi's own pins."""
