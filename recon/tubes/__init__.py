"""Roots as tubes: how they look through the water, their fit to the coverage of all views, and what they tell of the rig."""
