"""Scanning: taking all pictures of a plan, recovering from faults, and shutting the rig down safely.

The checks, marker measurements and homing are also used by the commands for bench tests.
"""
