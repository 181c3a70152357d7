"""Calibration boards and marker strips for printing at true scale."""
