"""Serial lines: transmission, recording and replay."""
