"""Reconstruction of the root tree and the solid shape from coverage.

The stages are density estimation, tracing, linking, removal of ghosts, detection of taproot and hypocotyl, and parent
assignment.
"""
