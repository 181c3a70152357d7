"""The rig: drivers of its devices, the scan that uses them, and an emulated twin of the whole rig."""
