"""Calibration of the cameras and the canister from the markers and the canister's edges in all pictures."""
