"""Time-lapse experiments, in which plants are scanned repeatedly according to a schedule."""
