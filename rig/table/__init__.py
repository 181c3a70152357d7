"""Drivers of the turntable and the lights, for a Marlin board or the pins of a Raspberry Pi."""
