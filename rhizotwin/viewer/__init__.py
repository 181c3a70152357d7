"""Viewer of results and live page of scans, for browsers that know the address with its token."""
