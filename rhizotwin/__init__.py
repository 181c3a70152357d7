"""The front door: the `rhizotwin` command, engine choice, import of pictures and the demo."""
