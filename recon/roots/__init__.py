"""From coverage to a tree of tubes and one solid.

Density, tracing, linking, ghosts, thick organs, and parent assignment.
"""
