"""The rig: drivers of the turntable, lights, arm and camera, the scan that uses them, and an emulated twin of it all."""
