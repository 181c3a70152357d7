"""A serial line: bytes to and from a device, kept and played back."""
