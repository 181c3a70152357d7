"""Frozen, validated descriptions of the rig, its contents and its scans, and the files that store them."""
