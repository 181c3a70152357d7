"""Roots as tubes: their appearance through the water, the fit to all views, and rig calibration from them."""
