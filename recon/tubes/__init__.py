"""Representation of roots as tubes: rendering through the water, fit to all views, and calibration of the rig."""
