"""Results and scans in a browser: served by this machine to those who have the address with its token."""
