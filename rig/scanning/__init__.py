"""Scanning: taking all pictures of a plan, recovery from faults, and safe shutdown.

The checks, marker measurements and homing are also used by the commands for the bench.
"""
