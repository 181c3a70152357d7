"""Simulation of scans: draw errors of the rig, render scenes with Mitsuba, and write datasets with ground truth."""
