"""Viewer of results, and live page of scans. Only browsers that know the address with its token can open them."""
