"""Time-lapse experiments: the same plants scanned again and again by a schedule."""
