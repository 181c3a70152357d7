"""The viewer of results and the live page of scans, for browsers that have the address with its token."""
