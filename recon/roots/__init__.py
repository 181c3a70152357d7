"""Reconstruction of the root tree and the solid shape from coverage.

Stages: density estimation, tracing, linking, removal of ghosts, taproot and hypocotyl, and parent assignment.
"""
