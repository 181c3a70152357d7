"""Roots as tubes: how they look through the water, their fit to all views, and what they tell of the rig."""
