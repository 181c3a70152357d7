"""Simulation of scans.

Errors of the rig are drawn, scenes are rendered with Mitsuba, and datasets are written with their ground truth.
"""
