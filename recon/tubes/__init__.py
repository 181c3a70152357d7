"""Roots as tubes: how they look through the water, and how they are fitted to the coverage of all views."""
