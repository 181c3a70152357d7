"""Drivers of the rig's devices, the scan procedure that uses them, and an emulated twin of the complete rig."""
