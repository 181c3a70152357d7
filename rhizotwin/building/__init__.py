"""Printed parts of a rig, with drawings and wiring diagrams."""
