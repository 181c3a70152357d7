"""From coverage to a tree of tubes and one solid.

Density, tracing, linking, ghosts, taproot and hypocotyl, and parent assignment.
"""
