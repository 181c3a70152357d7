"""Calibration of cameras and canister, from the markers of all pictures together and the edges of the canister."""
