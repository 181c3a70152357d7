"""The front door: the `rhizotwin` command, engine choice, import and export, plans, the demo; and the digest of sources."""
