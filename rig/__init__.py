"""Drivers of the rig's devices, the scan, and the emulated rig."""
