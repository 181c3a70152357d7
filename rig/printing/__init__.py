"""Boards and marker strips for the printer, at true scale."""
