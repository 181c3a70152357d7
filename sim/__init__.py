"""Simulation of pictures: draws the rig's errors, renders scenes with Mitsuba, writes datasets with truth."""
