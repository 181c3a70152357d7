"""Error budget of the reconstructed volume.

The causes of uncertainty are evaluated for each scan, from its own pictures and reconstruction.
"""
