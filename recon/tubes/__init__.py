"""Roots as tubes: appearance through the water, fit to all views, and calibration of the rig from the roots."""
