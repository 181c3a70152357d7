"""Drivers of turntable and lights, for a Marlin board or the pins of a Raspberry Pi."""
