"""Serial lines: transmission, recording and replay of bytes."""
